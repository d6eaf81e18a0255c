// Between the parts of calibration/camera.
#pragma once

#include <array>

#include "calibration/camera/camera_fit.h"
#include "calibration/camera/reprojection.h"
#include "calibration/core/least_squares.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

/// Angle-axis, then translation: the numbers of a pose that a solver moves.
using Pose = std::array<double, 6>;

[[nodiscard]] inline Eigen::Isometry3d transform_of(const Pose& pose) {
  const Eigen::Vector3d turn(pose[0], pose[1], pose[2]);
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  if (turn.norm() > 0) t.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  t.translation() = Eigen::Vector3d(pose[3], pose[4], pose[5]);
  return t;
}

using CameraParameters = std::array<double, kCameraParameters>;

[[nodiscard]] inline CameraParameters camera_parameters(const CameraModel& m) {
  if (m.projection == Projection::kannala_brandt)
    return {m.fx_px, m.fy_px, m.cx_px, m.cy_px, m.fisheye.k1, m.fisheye.k2, m.fisheye.k3, m.fisheye.k4};
  return {m.fx_px,   m.fy_px,   m.cx_px,   m.cy_px,   m.lens.k1, m.lens.k2,
          m.lens.p1, m.lens.p2, m.lens.k3, m.lens.k4, m.lens.k5, m.lens.k6};
}
[[nodiscard]] inline CameraModel camera_of(const CameraParameters& p, bool fisheye, int width_px,
                                           int height_px) {
  CameraModel m;
  m.width_px = width_px, m.height_px = height_px;
  m.fx_px = p[0], m.fy_px = p[1], m.cx_px = p[2], m.cy_px = p[3];
  if (fisheye) {
    m.projection = Projection::kannala_brandt;
    m.fisheye = {p[4], p[5], p[6], p[7]};
  } else {
    m.lens = {p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11]};
  }
  return m;
}

/// The block of CameraParameters for LeastSquares: names, resolutions, and what the model does not have held.
[[nodiscard]] std::vector<ParameterInfo> camera_infos(LensModel model, double focal_px, int width_px,
                                                      int height_px, bool hold);

}  // namespace rigor::calibration
