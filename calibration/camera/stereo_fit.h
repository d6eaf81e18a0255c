// Two cameras that are fixed to each other: where the right one stands in the left one's frame, from boards
// that both saw at the same instants.
//
// Unknowns: T_left_right (angle-axis vector and translation), the intrinsics of both cameras unless they are
// held, and for each pair of views the board's pose, which is marginalised. The covariance is that of all of
// them together: held intrinsics make it smaller than it is by what is not known of them.
#pragma once

#include <optional>

#include "calibration/camera/camera_fit.h"

namespace rigor::calibration {

struct StereoPair {
  BoardView left, right;  ///< of one board at one instant; the corners need not be the same
};

struct StereoFitOptions {
  /// Lens of each camera; ignored where its camera is given.
  LensModel left_model = LensModel::opencv4, right_model = LensModel::opencv4;
  std::optional<CameraModel> left{}, right{};  ///< held at these values
  bool robust = true;
  double reject_sigmas = 4;
  int threads = 0;
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

struct StereoFit {
  /// Parameters `rotation_x_rad` …, `x_m`, `y_m`, `z_m` of T_left_right (angle-axis vector, translation),
  /// then `left.fx_px` … and `right.fx_px` … of those cameras that were fitted.
  FitResult result;
  CameraModel left, right;
  LensModel left_model = LensModel::opencv4, right_model = LensModel::opencv4;
  Eigen::Isometry3d T_left_right = Eigen::Isometry3d::Identity();
  std::vector<CameraFit::Residual> residuals;  ///< of every corner: those of view 2·i left, 2·i + 1 right
  double rms_per_corner_px = 0;
};

/// bad_input: fewer than two pairs, pictures of several sizes in one camera, views that are not of one board
/// at one instant (then no one transform fits most of them).
[[nodiscard]] Result<StereoFit> fit_stereo(const std::vector<StereoPair>& pairs,
                                           const StereoFitOptions& options);

}  // namespace rigor::calibration
