// One expectation: what it looks at, within which bounds, and what it has seen. For this room alone.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>

#include "bench/expect/expectations.h"
#include "bench/motion/pose_error.h"
#include "rt-core/numbers.h"

namespace rigor {
namespace expect {

enum class Quantity : std::uint8_t {
  rate_hz,
  missing,
  late,
  age_ms,
  age_p99_ms,  // of a channel
  value,
  per_s,  // of a value
  failed,
  late_commands,
  dropped,  // of a sink
  wake_p50_us,
  wake_p99_us,
  wake_max_us,
  cycle_p99_us,
  skipped,
  misses,  // of the loop
  late_answers,
  skipped_turns,
  restarts,
  answer_p99_ms,  // of the application
  position_m,
  yaw_deg,  // of an estimate
  alarm     // of a pair
};
enum class Subject : std::uint8_t { channel, value, sink, loop, application, estimate };

struct Bounds {
  std::optional<double> min, max;
  [[nodiscard]] bool hold(double v) const { return !(min && !(v >= *min)) && !(max && !(v <= *max)); }
  [[nodiscard]] std::string text() const {
    if (min && max) return fmt::format("from {} to {}", *min, *max);
    return min ? fmt::format("of at least {}", *min) : fmt::format("of at most {}", *max);
  }
};

}  // namespace expect

struct Expectations::Check {
  Expected result;
  ConfigNode node;
  expect::Subject subject{};
  expect::Quantity quantity{};
  expect::Bounds bounds;
  bool wanted_alarm = false;
  Duration from, until;  ///< until 0: the end
  std::string name, value_name, against;

  // Bound.
  const SamplePort* port = nullptr;
  const CommandPort* commands = nullptr;
  SampleKind kind = SampleKind::none;
  std::size_t index = 0;
  Period period;
  Duration latency;
  std::optional<std::size_t> x, y, yaw, state;  ///< places in the estimate's command

  // Of the loop.
  bool begun = false;
  BenchTime t_first, t_last;
  PortCounters first, last;
  double previous = kNaN;
  BenchTime t_previous;
  Histogram ages;
  std::array<PlanePose, 64> estimates{};  ///< that no truth lies behind yet, oldest first
  std::size_t estimate_count = 0;
  std::array<PlanePose, 2> truths{};  ///< the last ones
  std::size_t truth_count = 0;

  [[nodiscard]] bool in_window(Duration since_start) const {
    return since_start >= from && (until.ns() == 0 || since_start <= until);
  }
  void look(double v, Duration since_start) noexcept {
    if (result.looked_at++ == 0) result.least = result.most = v;
    result.least = std::min(result.least, v);
    result.most = std::max(result.most, v);
    if (bounds.hold(v)) return;
    if (result.outside++ == 0) result.first_s = since_start.seconds();
  }
  /// Of a whole run or window: no instant.
  void judge(double v) noexcept {
    result.looked_at = 1;
    result.least = result.most = v;
    result.outside = !bounds.hold(v);
  }
  void take(double v, BenchTime t, Duration since_start) noexcept {
    if (quantity == expect::Quantity::value) look(v, since_start);
    if (quantity == expect::Quantity::per_s && std::isfinite(previous) && t > t_previous)
      look((v - previous) / (t - t_previous).seconds(), since_start);
    previous = v;
    t_previous = t;
  }
  void take_sample(Duration since_start) noexcept;
  void take_truth(BenchTime t0) noexcept;
  void add_estimate(const Command& c) noexcept;
  void end(const RunEnd& run, BenchTime t0);
};

}  // namespace rigor
