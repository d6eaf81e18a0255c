#include "sim/render/view/view_camera.h"

#include <algorithm>

namespace rigor::render {

std::array<double, 4> ViewCamera::edges() const {
  const Pinhole& p = pinhole;
  return {(-0.5 - p.cx_px) / p.fx_px, (p.width_px - 0.5 - p.cx_px) / p.fx_px, (-0.5 - p.cy_px) / p.fy_px,
          (p.height_px - 0.5 - p.cy_px) / p.fy_px};
}

ViewCamera::ViewCamera(const ViewRequest& request)
    : eye(request.T_world_camera.translation()), pinhole(request.pinhole) {
  const Eigen::Matrix3d r = request.T_world_camera.linear();
  right = r.col(0);
  down = r.col(1);
  forward = r.col(2);
  focal_px = std::max(pinhole.fx_px, pinhole.fy_px);
  const auto [left_t, right_t, top_t, bottom_t] = edges();
  const auto plane = [](const Eigen::Vector3d& n, double d) {
    const double k = 1.0 / n.norm();
    return Eigen::Vector4d(n.x() * k, n.y() * k, n.z() * k, d * k);
  };
  planes = {plane(right - left_t * forward, 0), plane(right_t * forward - right, 0),
            plane(down - top_t * forward, 0), plane(bottom_t * forward - down, 0),
            plane(forward, -pinhole.near_m)};
}

Seen seen(const ViewCamera& camera, const Eigen::AlignedBox3d& box, double margin_m) {
  if (box.isEmpty()) return Seen::outside;
  const Eigen::Vector3d centre = box.center() - camera.eye;
  const Eigen::Vector3d half = 0.5 * box.sizes() + Eigen::Vector3d::Constant(margin_m);
  Seen all = Seen::inside;
  for (const Eigen::Vector4d& p : camera.planes) {
    const double d = p.head<3>().dot(centre) + p.w();
    const double reach = p.head<3>().cwiseAbs().dot(half);
    if (d < -reach) return Seen::outside;
    if (d < reach) all = Seen::partly;
  }
  return all;
}

}  // namespace rigor::render
