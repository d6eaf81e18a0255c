#include "bench/sensing/camera_info.h"

#include "sim/world/pose.h"

namespace rigor {

record::msg::CameraInfo camera_info(const CameraModel& m) {
  record::msg::CameraInfo info;
  info.width = static_cast<std::uint32_t>(m.width_px);
  info.height = static_cast<std::uint32_t>(m.height_px);
  if (m.projection == Projection::kannala_brandt) {
    info.distortion_model = "equidistant";
    info.d = {m.fisheye.k1, m.fisheye.k2, m.fisheye.k3, m.fisheye.k4};
  } else if (m.lens.k4 == 0 && m.lens.k5 == 0 && m.lens.k6 == 0) {
    info.distortion_model = "plumb_bob";
    info.d = {m.lens.k1, m.lens.k2, m.lens.p1, m.lens.p2, m.lens.k3};
  } else {
    info.distortion_model = "rational_polynomial";
    info.d = {m.lens.k1, m.lens.k2, m.lens.p1, m.lens.p2, m.lens.k3, m.lens.k4, m.lens.k5, m.lens.k6};
  }
  info.k = {m.fx_px, 0, m.cx_px, 0, m.fy_px, m.cy_px, 0, 0, 1};
  info.r = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info.p = {m.fx_px, 0, m.cx_px, 0, 0, m.fy_px, m.cy_px, 0, 0, 0, 1, 0};
  return info;
}

std::optional<StereoCameraInfo> stereo_camera_info(const CameraModel& left, const CameraModel& right,
                                                   const Pose& T_left_right) {
  const Eigen::Isometry3d T = isometry_of(T_left_right);
  const Eigen::Vector3d baseline = T.translation();
  if (!(baseline.norm() > 1e-3)) return std::nullopt;
  // Rows of R_rectified_left are the new axes in the left camera's.
  const Eigen::Vector3d x = baseline.normalized();
  const Eigen::Vector3d forward = Eigen::Vector3d::UnitZ() + T.linear().col(2);
  const Eigen::Vector3d across = forward.cross(x);
  if (!(across.norm() > 1e-6 * forward.norm()) || !(forward.norm() > 1e-6)) return std::nullopt;
  const Eigen::Vector3d y = across.normalized(), z = x.cross(y);
  Eigen::Matrix3d R_rectified_left;
  R_rectified_left << x.transpose(), y.transpose(), z.transpose();
  const Eigen::Matrix3d R_rectified_right = R_rectified_left * T.linear();
  StereoCameraInfo both{camera_info(left), camera_info(right)};
  const double f_px = 0.5 * (left.fx_px + left.fy_px);
  for (auto* info : {&both.left, &both.right}) {
    const Eigen::Matrix3d& R = info == &both.left ? R_rectified_left : R_rectified_right;
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 3; ++column)
        info->r[static_cast<std::size_t>(3 * row + column)] = R(row, column);
    info->p = {f_px, 0, left.cx_px, 0, 0, f_px, left.cy_px, 0, 0, 0, 1, 0};
  }
  both.right.p[3] = -f_px * baseline.norm();
  return both;
}

}  // namespace rigor
