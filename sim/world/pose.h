// The pose that samples and motions carry (rigor::Pose) as a transform of Eigen, and back.
#pragma once

#include <Eigen/Geometry>

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

}  // namespace rigor
