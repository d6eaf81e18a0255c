// A sensor's poses during an exposure, for many rays. Internal to sim/sensors/camera.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <vector>

#include "sim/sensors/camera/exposure_timing.h"

namespace rigor {

/// Poses at equal steps as floats about an origin: between two of them the matrices may go linearly, for
/// rotations of a hundredth of a turn over the whole table to 1e-6 rad.
class PoseTable {
 public:
  static constexpr int kSteps = 64;
  PoseTable(const SensorMotion& motion, const Eigen::Vector3d& origin) {
    const int n = motion.still() ? 1 : kSteps + 1;
    for (int i = 0; i < n; ++i) {
      const Eigen::Isometry3d T = motion.at(n == 1 ? 0.0 : static_cast<double>(i) / kSteps);
      turn_.push_back(T.linear().cast<float>());
      from_.push_back((T.translation() - origin).cast<float>());
    }
  }
  void at(float share, Eigen::Matrix3f& turn, Eigen::Vector3f& from) const {
    if (turn_.size() == 1) {
      turn = turn_[0];
      from = from_[0];
      return;
    }
    const float x = std::clamp(share, 0.0F, 1.0F) * kSteps;
    const auto i = std::min(static_cast<std::size_t>(x), turn_.size() - 2);
    const float w = x - static_cast<float>(i);
    turn = (1 - w) * turn_[i] + w * turn_[i + 1];
    from = (1 - w) * from_[i] + w * from_[i + 1];
  }

 private:
  std::vector<Eigen::Matrix3f> turn_;
  std::vector<Eigen::Vector3f> from_;
};

}  // namespace rigor
