// What a LiDAR calls remission: gain of each beam, scale, noise; and the least remission that it still sees.
//
// On a matt wall remission is ρ_k·cos θ (lidar.glsl.h), so the logarithm of what the device tells is
//   log units = log(scale·ρ_k) + log gain_b + log cos θ
// linear in what is wanted. Gains are against their mean; the scale needs a wall of known reflectance.
#pragma once

#include <optional>

#include "calibration/lidar/bias_fit.h"
#include "calibration/lidar/detection_fit.h"
#include "calibration/lidar/range_noise.h"

namespace rigor::calibration {

struct RemissionFit {
  /// `remission_gain[i]` (where gains differ), `remission_scale` (surveyed reflectance), `remission_noise`,
  /// `minimum_remission`, `limit_remission`. What is missing is named in not_identifiable. Residuals: of log
  /// units.
  FitResult result;
  double limit_range_m = 0;  ///< where `limit_remission` is just seen
};

[[nodiscard]] RemissionFit fit_remission(const LidarReturns& returns, const models::LidarModel& sensor_model,
                                         const PlaneSearch& search, const BiasFit& bias,
                                         const NoiseFit* noise);

/// Relative noise of what the device tells, from repeated shots; its standard uncertainty.
struct RemissionNoise {
  double relative = 0, sigma = 0;
};
[[nodiscard]] std::optional<RemissionNoise> remission_noise(const NoiseFit& noise,
                                                            const models::LidarModel& sensor_model);

}  // namespace rigor::calibration
