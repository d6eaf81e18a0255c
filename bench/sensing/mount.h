// Where a simulated sensor sits, and what carries it.
//
//   T_world_sensor: { position_m: [0, -3, 1.6], look_at_m: [0, 0, 0.4] }
//   T_world_sensor: { position_m: [0, 0, 1.2], quaternion_wxyz: [1, 0, 0, 0] }
//   T_world_sensor: { position_m: [0, 0, 1.2], roll_pitch_yaw_deg: [0, 0, 90] }
//   parent: turntable        the sensor goes with that node, or with that platform; its pose is then
//   T_parent_sensor: { … }   in the node's frame
//   T_world_sensor: { position_m: [0, 0, 1.2], above_ground: true, … }
//                            z of position_m and look_at_m counts from the terrain below them
//   motion: { velocity_m_per_s: [1, 0, 0], yaw_rate_deg_per_s: 10 }
//
// `motion` is that of a platform which stands at the sensor's place when the run starts. The velocity is in
// the axes of the frame that the pose is in (world, or parent) at that instant, and turns with the platform
// about z.
#pragma once

#include <functional>
#include <memory>

#include "bench/sensing/sensor_world.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

struct Mount {
  world::NodeId parent{};  ///< none: the world
  int body = -1;           ///< of a WorldMotion: the platform that carries it, in place of `parent`
  Eigen::Isometry3d T_parent_sensor = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity_m_per_s = Eigen::Vector3d::Zero();
  double yaw_rate_radps = 0;
  /// In place of a parent: what carries the sensor, read with each capture by the thread that captures.
  /// Whoever owns it moves it between captures.
  std::shared_ptr<const Eigen::Isometry3d> T_world_carrier{};

  [[nodiscard]] bool moves() const { return yaw_rate_radps != 0 || !velocity_m_per_s.isZero(0); }
  /// Pose in the parent's frame, `since_start` after the start.
  [[nodiscard]] Eigen::Isometry3d at(Duration since_start) const;
  /// As a function of time. The world outlives it.
  [[nodiscard]] render::PoseFunction T_world_sensor(const SensorWorld::Moment& world,
                                                    BenchTime t_start) const;
};

/// The pose of `T_world_sensor`, whose axes look_at_m takes for those of a camera or of a scanner (x
/// forward).
enum class SensorAxes : std::uint8_t { optical, forward };
/// Throws ConfigError.
/// `ground_z_m`: of the terrain at x, y in the pose's frame, for `above_ground`; null where there is none.
[[nodiscard]] Eigen::Isometry3d read_pose(ConfigNode n, SensorAxes axes,
                                          const std::function<double(double, double)>& ground_z_m = nullptr);
/// Reads T_world_sensor, or parent and T_parent_sensor, and motion. Throws ConfigError.
[[nodiscard]] Mount read_mount(ConfigNode params, const SensorWorld& world, SensorAxes axes);

}  // namespace rigor
