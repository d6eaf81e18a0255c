#include "sim/platform/ground.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace rigor {

Eigen::Vector3d Ground::normal(double x_m, double y_m) const {
  // A bilinear patch is linear along either axis, so that a difference over any step within it is exact.
  constexpr double kStep_m = 1e-3;
  const double dx = height_m(x_m + kStep_m, y_m) - height_m(x_m - kStep_m, y_m);
  const double dy = height_m(x_m, y_m + kStep_m) - height_m(x_m, y_m - kStep_m);
  return Eigen::Vector3d(-dx, -dy, 2 * kStep_m).normalized();
}

Footprint::Footprint(std::span<const Eigen::Vector2d> wheels_m) : count_(std::min(wheels_m.size(), kMost)) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < count_; ++i) {
    wheel_m_[i] = wheels_m[i];
    const Eigen::Vector3d row(1, wheels_m[i].x(), wheels_m[i].y());
    normal += row * row.transpose();
  }
  const Eigen::Matrix3d inverse = normal.inverse();
  for (std::size_t i = 0; i < count_; ++i)
    weight_[i] = inverse * Eigen::Vector3d(1, wheel_m_[i].x(), wheel_m_[i].y());
}

Footprint::Stand Footprint::stand(const Ground& ground, double x_m, double y_m, double yaw_rad) const {
  const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
  // Heights over that under the origin, so that no digits go to where the world's zero is.
  const double z0 = ground.height_m(x_m, y_m);
  Eigen::Vector3d plane = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < count_; ++i) {
    const Eigen::Vector2d& w = wheel_m_[i];
    plane += weight_[i] * (ground.height_m(x_m + c * w.x() - s * w.y(), y_m + s * w.x() + c * w.y()) - z0);
  }
  const Eigen::Vector3d n = Eigen::Vector3d(-plane.y(), -plane.z(), 1).normalized();
  return {z0 + plane.x(), -std::asin(n.y()), std::atan2(n.x(), n.z())};
}

}  // namespace rigor
