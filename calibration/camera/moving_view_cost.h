// The corners of one view whose board moves while the rows are read. Internal to calibration/camera.
#pragma once

#include <ceres/cost_function.h>

#include <array>
#include <vector>

#include "calibration/camera/board.h"
#include "calibration/camera/reprojection.h"

namespace rigor::calibration {

/// Poses of neighbouring views, and their times against this one's.
struct MotionWindow {
  static constexpr std::size_t kMost = 5;
  std::size_t count = 0;
  std::array<double, kMost> t_s{};

  /// Weights of the poses in the interpolated one at time `t`, and their derivatives by time.
  void weights(double t, double* weight, double* slope) const;
  /// The interpolated pose: angle-axis and translation.
  [[nodiscard]] std::array<double, 6> pose_at(double t, const double* const* poses) const;
};

inline constexpr double kUs = 1e-6;  ///< s

/// Residuals u, v of `points` in pixels. Blocks: camera (12), line time in microseconds (1), then the poses
/// of the window (6 each). A point that has no image is infinity. `middle_row_px`: of the picture's time.
[[nodiscard]] ceres::CostFunction* moving_view_cost(std::vector<BoardPoint> points, bool fisheye,
                                                    const MotionWindow& window, double middle_row_px);

}  // namespace rigor::calibration
