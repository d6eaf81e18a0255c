// Noise of numbers that a device rounds: 3.6 mm of noise in whole millimetres has a median absolute deviation
// of 2 or 3, so that estimate is off by up to 20 %; and noise below a third of a step hardly moves a digit.
#pragma once

#include <cstdint>
#include <vector>

namespace rigor::calibration {

/// A series of one quantity in whole steps: how often each value came.
struct RoundedSeries {
  std::vector<std::pair<std::int64_t, std::uint32_t>> counts;  ///< value, times
};

/// Mean variance of rounded values about their own mean, in steps², for noise of `sigma` steps and a true
/// value that may lie anywhere between two steps:
///   σ² + 1/12 − Σ_k exp(−4π²k²σ²)/(2π²k²)
/// (Widrow & Kollár, Quantization Noise, 2008: characteristic function of the rounding error). No noise, no
/// variance; from σ = 0.4 on Sheppard's 1/12.
[[nodiscard]] double rounded_variance(double sigma);

struct RoundedSigma {
  double sigma = 0;        ///< steps
  double uncertainty = 0;  ///< standard
};
/// One sigma of several series, each with a true value of its own: maximum of the likelihood of the rounded
/// values, Π ∫ Π [Φ((x + ½ − µ)/σ) − Φ((x − ½ − µ)/σ)] dµ over the series. Integrating over µ (flat) counts
/// the degree of freedom that each takes. Zero where no series has more than one value.
[[nodiscard]] RoundedSigma sigma_of_rounded(const std::vector<RoundedSeries>& series);

}  // namespace rigor::calibration
