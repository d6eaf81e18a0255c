// The pose that samples and motions carry (rigor::Pose) as a transform of Eigen, and back.
#pragma once

#include <Eigen/Geometry>
#include <cmath>

#include "sensor-hal/types/sample.h"

namespace rigor {

[[nodiscard]] inline Eigen::Isometry3d isometry_of(const Pose& pose) {
  const auto& q = pose.orientation_wxyz;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
  T.translation() = Eigen::Vector3d(pose.position_m[0], pose.position_m[1], pose.position_m[2]);
  return T;
}
[[nodiscard]] inline Pose pose_of(const Eigen::Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  return {{T.translation().x(), T.translation().y(), T.translation().z()}, {q.w(), q.x(), q.y(), q.z()}};
}
/// The smallest rotation that turns direction `from` into direction `to`; neither may be zero. For opposite
/// directions, about some axis across. Eigen's FromTwoVectors finds that axis by a singular value
/// decomposition, which costs seconds of compiling wherever it is called.
[[nodiscard]] inline Eigen::Quaterniond rotation_between(const Eigen::Vector3d& from,
                                                         const Eigen::Vector3d& to) {
  const Eigen::Vector3d a = from.normalized(), b = to.normalized();
  const double c = b.dot(a);
  if (c < -1 + 1e-12) {
    const Eigen::Vector3d across = a.unitOrthogonal();
    return {0, across.x(), across.y(), across.z()};
  }
  const double s = std::sqrt((1 + c) * 2), inverse = 1 / s;
  const Eigen::Vector3d axis = a.cross(b);
  const Eigen::Quaterniond q(s * 0.5, axis.x() * inverse, axis.y() * inverse, axis.z() * inverse);
  // Nearly opposite directions cancel in 1 + c, and the length with it.
  return c < -0.99 ? q.normalized() : q;
}

}  // namespace rigor
