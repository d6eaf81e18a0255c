// All corners of one view as one function of the fit, with derivatives: the lens through jets of fixed size
// over the simulator's own formulas, the pose by the chain rule. Internal to calibration/camera.
#pragma once

#include <ceres/cost_function.h>

#include <memory>
#include <vector>

#include "calibration/camera/board.h"

namespace rigor::calibration {

/// What stands between a view's pose and its corners, besides the camera.
struct ViewCostOptions {
  bool fisheye = false;
  /// The camera sees through a second pose of its own: p_camera = T_camera_other · T_other_board · p_board.
  bool rig = false;
  /// Distorted coordinates are multiplied by a factor before they become pixels (lateral chromatic
  /// aberration).
  bool magnified = false;
};

/// Residuals u, v of `points` in pixels, one after the other. Blocks: camera (12), [factor (1)],
/// [T_camera_other (6)], pose (6); poses are angle-axis and translation. A point that has no image is
/// infinity. `points` is copied.
[[nodiscard]] ceres::CostFunction* view_cost(std::vector<BoardPoint> points, const ViewCostOptions& options);

}  // namespace rigor::calibration
