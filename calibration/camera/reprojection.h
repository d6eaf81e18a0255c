// Where a point in the camera's frame falls, over any number type. Internal to calibration/camera.
#pragma once

#include <ceres/rotation.h>

#include "sensor-hal/models/one_source.h"

namespace rigor::calibration {

/// fx fy cx cy, then k1 k2 p1 p2 k3 k4 k5 k6 (fisheye: k1 k2 k3 k4 in the first four).
inline constexpr int kCameraParameters = 12;
inline constexpr double kThetaMax = 3.14159265358979;
/// `factor`: lateral chromatic aberration, of the distorted coordinates.
template <class T>
bool project_point(const T* camera, const T* p, bool fisheye, double theta_max, const T& factor, T& u, T& v) {
  using Lens = models::LensMath<T>;
  T xd, yd;
  if (fisheye) {
    T valid;
    Lens::fisheye_project(p[0], p[1], p[2], camera[4], camera[5], camera[6], camera[7], T(theta_max), xd, yd,
                          valid);
    if (valid < T(0.5)) return false;
  } else {
    if (!(p[2] > T(0))) return false;
    Lens::lens_distort(p[0] / p[2], p[1] / p[2], camera[4], camera[5], camera[6], camera[7], camera[8],
                       camera[9], camera[10], camera[11], xd, yd);
  }
  u = factor * camera[0] * xd + camera[2];
  v = factor * camera[1] * yd + camera[3];
  return true;
}

/// One corner; pose: angle-axis and translation of T_camera_board.
struct Reprojection {
  double x_m, y_m, u_px, v_px;
  bool fisheye;
  template <class T>
  bool operator()(const T* camera, const T* pose, T* residual) const {
    const T board[3] = {T(x_m), T(y_m), T(0)};
    T p[3];
    ceres::AngleAxisRotatePoint(pose, board, p);
    for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
    T u, v;
    if (!project_point(camera, p, fisheye, kThetaMax, T(1), u, v)) return false;
    residual[0] = u - T(u_px);
    residual[1] = v - T(v_px);
    return true;
  }
};

}  // namespace rigor::calibration
