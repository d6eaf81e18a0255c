// What bench time 0 was in UTC: how recordings of a monotonic clock get a date.
#pragma once

#include "rt-core/time.h"

namespace rigor {

/// The same instant on the bench clock and in UTC.
struct EpochPair {
  BenchTime bench;
  RealtimeTime utc;
  Duration sigma;  ///< standard uncertainty of the pairing; 0 in virtual time

  /// UTC of another bench instant. CLOCK_REALTIME is slewed and stepped by NTP, so take a pair close to it.
  [[nodiscard]] constexpr RealtimeTime to_utc(BenchTime t) const { return utc + (t - bench); }
  [[nodiscard]] constexpr BenchTime to_bench(RealtimeTime t) const { return bench + (t - utc); }
};

/// Virtual runs: bench time 0 is 2020-01-01T00:00:00Z, always, so that recordings repeat byte for byte.
inline constexpr EpochPair kVirtualEpoch{BenchTime(0), RealtimeTime(1'577'836'800'000'000'000), Duration(0)};

/// Wall runs (bench time is CLOCK_MONOTONIC): UTC read between two readings of MONOTONIC, the tightest of a
/// few tries; sigma is that of a uniform error within the bracket. Any thread but the loop; some µs, no
/// allocation.
[[nodiscard]] inline EpochPair read_epoch() noexcept {
  EpochPair best;
  std::int64_t best_width = -1;
  for (int i = 0; i < 8; ++i) {
    const MonotonicTime before = monotonic_now();
    const RealtimeTime utc = realtime_now();
    const MonotonicTime after = monotonic_now();
    const std::int64_t width = (after - before).ns();
    if (best_width >= 0 && width >= best_width) continue;
    best_width = width;
    best.bench = BenchTime(before.ns() + width / 2);
    best.utc = utc;
  }
  best.sigma =
      Duration(static_cast<std::int64_t>(static_cast<double>(best_width) * 0.288675) + 1);  // width / √12
  return best;
}

}  // namespace rigor
