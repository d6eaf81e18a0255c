// Test pictures that carry their own truth: the start of their exposure on CLOCK_MONOTONIC in the first 8
// bytes, and bytes made from it in the rest. So a receiver can tell when a picture was really taken, and
// whether every byte of it belongs to one and the same picture.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <mutex>
#include <vector>

#include "drivers/aravis/gige_device_model.h"
#include "tests/drivers/aravis/gige_udp_test_tools.h"

namespace rigor::gige::testing {

/// The exposures of the last pictures that were made in this process.
struct TruthLog {
  std::mutex mutex;
  std::deque<std::uint64_t> starts_ns;
  static TruthLog& instance() {
    static TruthLog log;
    return log;
  }
  void add(std::uint64_t t) {
    const std::lock_guard lock(mutex);
    if (starts_ns.size() == 4096) starts_ns.pop_front();
    starts_ns.push_back(t);
  }
  [[nodiscard]] std::uint64_t nearest(std::uint64_t t) {
    const std::lock_guard lock(mutex);
    std::uint64_t best = 0;
    const auto off = [t](std::uint64_t x) { return x > t ? x - t : t - x; };
    for (const std::uint64_t s : starts_ns)
      if (best == 0 || off(s) < off(best)) best = s;
    return best;
  }
};

inline bool fill_stamped(const FrameRequest& r, MutableBytes out) {
  const auto truth = static_cast<std::uint64_t>(r.t_exposure_start.ns());
  TruthLog::instance().add(truth);
  fill_pattern(truth, out);
  if (out.size() >= 8) store_be(out, 0, truth);
  return true;
}

struct Verdict {
  std::uint64_t exposure_start_ns = 0;  ///< 0: that part never came
  std::size_t wrong = 0;                ///< bytes that are neither this picture's nor zero
  std::size_t zero = 0;                 ///< bytes that are zero and should not be
};
/// `about_ns`: where the picture's first bytes are missing, it is the one that was exposed nearest to this
/// instant.
inline Verdict judge_stamped(Bytes picture, std::uint64_t about_ns = 0) {
  Verdict v;
  if (picture.size() < 8) return v;
  v.exposure_start_ns = load_be<std::uint64_t>(picture, 0);
  const std::uint64_t seed =
      v.exposure_start_ns != 0 ? v.exposure_start_ns : TruthLog::instance().nearest(about_ns);
  std::vector<std::uint8_t> expected(picture.size());
  fill_pattern(seed, expected);
  for (std::size_t i = 8; i < picture.size(); ++i) {
    if (picture[i] == expected[i]) continue;
    ++(picture[i] == 0 ? v.zero : v.wrong);
  }
  return v;
}

}  // namespace rigor::gige::testing
