// Where a calibrated camera sees a board, and how sure it is of the board's plane.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "calibration/camera/board.h"
#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

struct BoardPose {
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();
  /// Of the board's own rotation vector's x and y [rad] and shift along its z [m]: what PlaneObservation
  /// takes.
  Eigen::Matrix3d plane_covariance = Eigen::Matrix3d::Zero();
  double rms_px = 0;  ///< per coordinate
  int points = 0;     ///< that were used
};

/// Least squares over the points, through the camera's whole lens; the camera itself is taken as known.
/// bad_input: fewer than four points that the lens has a ray for, a picture of another size. Any thread.
[[nodiscard]] Result<BoardPose> pose_of_board(const BoardView& view, const CameraModel& camera);

}  // namespace rigor::calibration
