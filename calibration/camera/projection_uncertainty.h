// What the covariance of intrinsics means in the picture. Internal to calibration/camera.
#pragma once

#include "calibration/camera/camera_fit.h"

namespace rigor::calibration {

/// `covariance` of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 (12 x 12; rows of what was held are 0).
[[nodiscard]] UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance);

/// 95 % quantile over the picture of how far two models put the same ray apart, after the best rotation
/// between them, in pixels.
[[nodiscard]] double projection_difference_p95_px(const CameraModel& a, const CameraModel& b);

}  // namespace rigor::calibration
