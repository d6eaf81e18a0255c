// The `latency_ms` of a channel from how long its samples took: one that all but a stated share of the
// samples keep.
//
//   recommended = upper confidence bound of the quantile + 2 σ of the capture's stamp, rounded up to 0.1 ms
//
//   bound    of the quantile asked for: the sample of the rank that order_statistics.h gives, whatever the
//            distribution is. Where there are too few samples for that, the tail above the samples' 0.9
//            quantile is taken as exponential (Rényi: the sum of k excesses is then Gamma(k)), and the result
//            is never below the largest sample.
//   2 σ      t_capture is known to σ only, and the next run maps the device's clock anew.
//
// The bounds hold for samples of one distribution. Whether the data contradict that is judged by parts
// (recordings, or the halves of one): where the confidence intervals of a quantile do not meet, the bound is
// that of the slowest part, and `stationary` is false.
//
// All durations in nanoseconds. Any thread; allocates.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::calibration {

struct LatencyOptions {
  double quantile = 0.999;    ///< share of the samples that are to be in time
  double confidence = 0.95;   ///< of the bound
  std::int64_t sigma_ns = 0;  ///< standard uncertainty of t_capture
};

/// Samples of one recording, in the order of their captures.
struct LatencyPart {
  std::string name;
  std::vector<std::int64_t> latency_ns;
};

enum class LatencyBound : std::uint8_t {
  order_statistic,  ///< assumes nothing of the distribution
  exponential_tail  ///< too few samples: assumes a tail that falls off at least exponentially
};

struct LatencyFit {
  std::size_t samples = 0;
  std::int64_t p50_ns = 0, p99_ns = 0, p999_ns = 0, max_ns = 0;  ///< of the samples, by nearest rank
  std::int64_t p50_low_ns = 0, p50_high_ns = 0;                  ///< two-sided confidence interval
  std::int64_t bound_ns = 0;                                     ///< of the quantile asked for
  LatencyBound method = LatencyBound::order_statistic;
  std::size_t samples_needed = 0;  ///< for a bound by order statistics
  double proven_quantile = 0;      ///< the largest that these samples bound by order statistics
  std::int64_t recommended_ns = 0;

  /// Confidence interval of the quantile `part_quantile` in each part.
  struct Part {
    std::string name;
    std::size_t samples = 0;
    std::int64_t low_ns = 0, high_ns = 0;
  };
  std::vector<Part> parts;
  double part_quantile = 0;  ///< where the parts contradict each other, else the largest that they could
  bool stationary = true;
};

inline constexpr std::int64_t kLatencyStep_ns = 100'000;  ///< recommendations are multiples of it
inline constexpr std::size_t kFewestLatencies = 20;       ///< below, nothing is recommended

/// bad_input: fewer than kFewestLatencies, a quantile or a confidence that is not between 0 and 1.
[[nodiscard]] Result<LatencyFit> fit_latency(const std::vector<LatencyPart>& parts,
                                             const LatencyOptions& options);

/// Up to the next multiple of kLatencyStep_ns; never below 0.
[[nodiscard]] std::int64_t round_latency_up(std::int64_t latency_ns);

}  // namespace rigor::calibration
