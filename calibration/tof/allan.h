// Allan deviation: how far averaging over a time τ helps, and where it stops.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace rigor::calibration {

struct AllanPoint {
  double tau_s = 0;
  std::size_t averaged = 0;  ///< samples in τ
  double deviation = 0;      ///< in the unit of the series
  double low = 0, high = 0;  ///< 95 % interval
  double freedom = 0;        ///< equivalent degrees of freedom
  /// Exponent of the noise's power spectrum that dominates at this τ: 0 white, −1 flicker, −2 random walk.
  int exponent = 0;
};

/// Overlapping Allan deviation of a series at rest, at τ of 1, 2, 5, 10 … samples up to a quarter of it.
/// Intervals from the chi-squared distribution with the equivalent degrees of freedom for the noise type
/// found by the autocorrelation of neighbours (Riley, NIST SP 1065, 5.2.4, 5.4.1, 5.5.6). Empty for fewer
/// than 8.
[[nodiscard]] std::vector<AllanPoint> overlapping_allan(std::span<const double> series, double period_s);

/// Of these points the first whose interval lies above white noise of `sigma` (one sample): from there on
/// averaging gains less than 1/√n. Null: none does.
[[nodiscard]] const AllanPoint* averaging_limit(const std::vector<AllanPoint>& points, double sigma);

}  // namespace rigor::calibration
