// What a LiDAR calls remission: gain of each beam, scale, noise; and the least remission that it still sees.
//
// On a matt wall remission is ρ_k·cos θ (lidar.glsl.h), so the logarithm of what the device tells is
//   log units = log(scale·ρ_k) + log gain_b + log cos θ
// linear in what is wanted. Gains are against their mean; the scale needs a wall of known reflectance.
#pragma once

#include <optional>

#include "calibration/lidar/bias_fit.h"
#include "calibration/lidar/range_noise.h"

namespace rigor::calibration {

struct RemissionFit {
  /// `remission_gain[i]` (where gains differ), `remission_scale` (surveyed reflectance), `remission_noise`,
  /// `minimum_remission`. What is missing is named in not_identifiable. Residuals: of log units.
  FitResult result;
};

[[nodiscard]] RemissionFit fit_remission(const LidarReturns& returns, const models::LidarModel& sheet,
                                         const PlaneSearch& search, const BiasFit& bias,
                                         const NoiseFit* noise);

struct DetectionEdge {
  double at = 0, sigma = 0;
  bool sharp = false;  ///< false: `at` is only what it is at most
};
/// Where returns set in: the least of `values` for a threshold that is blurred by the noise of what the
/// device tells (standard deviation `blur` at the edge). A threshold cuts the distribution off; where it runs
/// out by itself instead (Poisson likelihoods 6 apart), there is only a bound. nullopt: too few values.
[[nodiscard]] std::optional<DetectionEdge> detection_edge(std::vector<double> values, double blur,
                                                          double step);

}  // namespace rigor::calibration
