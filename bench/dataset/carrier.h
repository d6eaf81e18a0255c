// What a pose of a dataset places: a platform with the sensors that ride on it, or sensors that stand in the
// world, fixed to each other.
#pragma once

#include <string>
#include <vector>

#include "bench/dataset/poses.h"
#include "bench/sensing/simulation.h"

namespace rigor::dataset {

struct MountedChannel {
  std::string name;
  SampleKind kind = SampleKind::none;
  ConfigNode params;  ///< of its simulated side
};

class Carrier {
 public:
  /// bad_input with place: channels on two platforms, or on a platform and in the world, or on a node of the
  /// world, which no pose can move.
  [[nodiscard]] static Result<Carrier> of(const std::vector<MountedChannel>& channels,
                                          Simulation& simulation);

  /// Of the platform; empty where it is none.
  [[nodiscard]] const std::string& platform() const { return platform_; }
  [[nodiscard]] const Mount& mount(std::size_t channel) const { return mounts_[channel]; }
  [[nodiscard]] const Eigen::Isometry3d& T_carrier_sensor(std::size_t channel) const {
    return T_carrier_sensor_[channel];
  }
  [[nodiscard]] const Eigen::Isometry3d& T_world_rig() const { return T_world_rig_; }
  /// On the ground, upright (a platform: square to the slope). Not finite where there is no ground.
  [[nodiscard]] Eigen::Isometry3d stand(const WantedPose& wanted, const Ground& ground) const;
  /// Puts it there, for the captures that follow with this motion.
  void move(const Eigen::Isometry3d& T_world_carrier, WorldMotion& motion) const;

 private:
  std::string platform_;
  std::size_t body_ = 0;
  std::shared_ptr<Eigen::Isometry3d>
      T_world_carrier_;  ///< of sensors without a platform; their mounts read it
  Eigen::Isometry3d T_world_rig_ = Eigen::Isometry3d::Identity();
  double height_m_ = 0;  ///< of the rig's, above the ground
  std::vector<Mount> mounts_;
  std::vector<Eigen::Isometry3d> T_carrier_sensor_;
};

}  // namespace rigor::dataset
