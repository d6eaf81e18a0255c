// Inertial units, satellite receivers and odometry of a rig: what reads their keys and puts them on a mount.
//
//   imu:
//     kind: imu
//     backend: simulated
//     sensor: ../sensors/imu-mems.yaml
//     parent: robot                     # or T_world_sensor and motion, see mount.h
//     T_parent_sensor: { … }
//     gravity_mps2: 9.80665             # left away: of the ellipsoid where the world lies, else this
//     origin: { latitude_deg: 50.4, longitude_deg: 6.5, height_m: 600 }   # in place of the world's Place
//   gnss:
//     kind: nav_fix                     # as above, without gravity, and
//     canopy: 0.3                       # share of the sky that trees cover; 0
//   odometry:
//     kind: odometry
//     platform: robot                   # its joints `left` and `right`; or
//     wheels: { left: robot.left, right: robot.right }    # joints by name; or
//     T_world_sensor: { … }             # with `motion`: of ideal wheels that go so
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "bench/sensing/sensor_world.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Kinds imu, nav_fix and odometry.
[[nodiscard]] bool is_inertial(SampleKind kind);

struct InertialSetup {
  std::string name;  ///< keys the noise, with the seed
  std::uint64_t seed = 0;
  Duration period;
  bool ideal = false;
  /// Index of a joint in a WorldMotion, by name.
  std::function<Result<std::size_t>(const std::string&)> joint;
};
/// The world outlives the provider. Errors: not_found and bad_input with place.
[[nodiscard]] Result<std::shared_ptr<SampleProvider>> make_inertial(SampleKind kind, const ConfigNode& params,
                                                                    const InertialSetup& setup,
                                                                    SensorWorld& world);

}  // namespace rigor
