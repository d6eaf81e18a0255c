// Small things that several parts need: angles, a quantile, a Gaussian over poses in the plane.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace rigor::forest {

/// To −π … π.
[[nodiscard]] inline double wrapped_rad(double angle_rad) noexcept {
  return std::remainder(angle_rad, 6.283185307179586);
}

/// Upper limit of a chi-squared variable at 0.999: Wilson and Hilferty, PNAS 1931; within 1 % from 2 degrees
/// of freedom on.
[[nodiscard]] inline double chi_squared_999(double degrees) noexcept {
  const double a = 2 / (9 * degrees);
  const double root = 1 - a + 3.0902 * std::sqrt(a);
  return degrees * root * root * root;
}

/// x [m], y [m], yaw [rad] of the base in the world, and its covariance.
struct PoseGaussian {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Identity();
};

/// Where a point of the world is seen from a pose, and its derivative by the pose.
struct SeenPoint {
  Eigen::Vector2d p_base;
  Eigen::Matrix<double, 2, 3> by_pose;
  Eigen::Matrix2d by_point;
};
[[nodiscard]] inline SeenPoint seen_from(const Eigen::Vector3d& pose, double x_m, double y_m) noexcept {
  const double c = std::cos(pose.z()), s = std::sin(pose.z());
  SeenPoint out;
  out.by_point << c, s, -s, c;
  out.p_base = out.by_point * Eigen::Vector2d(x_m - pose.x(), y_m - pose.y());
  out.by_pose.leftCols<2>() = -out.by_point;
  out.by_pose.col(2) = Eigen::Vector2d(out.p_base.y(), -out.p_base.x());
  return out;
}

}  // namespace rigor::forest
