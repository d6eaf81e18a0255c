// Noise of a range against the amplitude of the light that came back.
//
// Data are variances of groups of samples of nearly one amplitude (NoiseBin). Laws, σ the standard deviation
// of one range, A the amplitude in whatever unit it is recorded:
//
//   shot             σ = s/√A                shot noise of the signal alone
//   inverse          σ = b/A                 noise that does not know of the signal
//   floor_inverse    σ = a + b/A
//   shot_read        σ² = p/A + q/A²         the formula of the model: c/(4π f √2)·√(A + B + read²)/(C·A)
//   shot_read_floor  σ² = n + p/A + q/A²     and a floor, as a fixed pattern makes it
//
// What a group's variance is under a law follows from the group's means of 1/A and 1/A², exactly, however
// wide it is. The fit is of ln σ, by weighted least squares; beside the statistical uncertainty of each group
// the law itself may be off by a relative τ, whose maximum-likelihood value is reported: 0 where the law is
// true. Laws are compared by BIC and by withheld bands of amplitude.
#pragma once

#include <array>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

enum class NoiseLaw : std::uint8_t { shot, inverse, floor_inverse, shot_read, shot_read_floor };
inline constexpr std::array kNoiseLaws{NoiseLaw::shot, NoiseLaw::inverse, NoiseLaw::floor_inverse,
                                       NoiseLaw::shot_read, NoiseLaw::shot_read_floor};
[[nodiscard]] std::string_view noise_law_name(NoiseLaw law);
/// bad_input with the names that there are.
[[nodiscard]] Result<NoiseLaw> parse_noise_law(const std::string& name);

/// Samples of nearly one amplitude.
struct NoiseBin {
  double amplitude = 0;       ///< in their middle, for plots
  double inverse = 0;         ///< mean of 1/A
  double shot_inverse = 0;    ///< mean of 1/A for the shot noise's share, where the two differ; else the same
  double inverse_square = 0;  ///< mean of 1/A²
  double variance_m2 = 0;     ///< unbiased
  double dof = 0;             ///< numbers that the variance comes from
  /// Standard uncertainty of ln σ; 0: that of a normal sample of `dof`.
  double log_sigma = 0;
  std::size_t samples = 0;
};

/// Coefficients of a law: a, b; p, q, n; in metres (square metres) and powers of the amplitude's unit.
struct NoiseCoefficients {
  NoiseLaw law = NoiseLaw::inverse;
  std::array<double, 3> c{};
  /// Of samples of this amplitude; 0 for an amplitude of none.
  [[nodiscard]] double sigma_m(double amplitude) const;
};

struct NoiseLawFit {
  FitResult result;  ///< parameters noise_…; residuals are ln(σ/law)
  NoiseCoefficients noise;
  double misfit = 0;  ///< RMS of σ/law − 1 over the groups
  double tau = 0;     ///< of that, what the groups' own uncertainty does not explain
  /// The same for every law that was tried, in the order of result.candidates.
  std::vector<NoiseCoefficients> all;
  std::vector<double> misfits;
};

struct NoiseLawOptions {
  std::vector<NoiseLaw> laws{kNoiseLaws.begin(), kNoiseLaws.end()};
  int folds = 5;  ///< bands of amplitude that are withheld in turn; 0: none
};

/// bad_input: fewer groups than coefficients, or a group without amplitude or variance.
[[nodiscard]] Result<NoiseLawFit> fit_noise_law(const std::vector<NoiseBin>& bins,
                                                const NoiseLawOptions& options);

}  // namespace rigor::calibration
