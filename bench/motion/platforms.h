// Platforms of a rig's world, as its `simulation.platforms` has them:
//
//   platforms:
//     robot:
//       kind: skid-steer                             # skid-steer | harvester | trajectory
//       model: ../platforms/seekurjr.yaml             # its numbers; the model's own where there is none
//       T_world_start: { position_m: [2, 1], yaw_deg: 90 }    # x, y; it stands on the ground
//       visible: true                                 # whether sensors see it
//       channel: truth                                # mixed rigs: who tells the bench where it is
//       felled: head                                  # mixed rigs: who tells the bench what it cuts
//     cart:
//       kind: trajectory
//       poses: way.csv                                # columns t_s,x_m,y_m,z_m and a rotation (trajectory.h)
//       recording: drive.mcap                         # or: the poses of a recording's channel, from its
//       first poses_of: truth spline: cubic                                 # cubic | quintic
//
// Sensors ride with `parent: robot` (the body) or `parent: robot.PART` and `T_parent_sensor`.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

class Ground;
class Platform;
struct Stem;

/// One platform of one world.
struct WorldPlatform {
  std::string name;
  std::shared_ptr<Platform> model;
  std::uint32_t first_joint = 0;  ///< in a WorldMotion: behind the world's own joints
  bool visible = true;
};

/// Body i of a WorldMotion is the i-th. bad_input with place: unknown models and keys, more bodies or joints
/// than a WorldMotion holds. `world_joints`: how many joints the world itself has. Setup context.
/// `stems`: the world's trees.
[[nodiscard]] Result<std::vector<WorldPlatform>> make_platforms(const SimulationConfig& config,
                                                                const Ground& ground,
                                                                const std::vector<Stem>& stems,
                                                                std::size_t world_joints);

/// Writes what the platforms say of an instant into a motion of the world.
void add_platform_motion(WorldMotion& motion, const WorldPlatform& platform, std::size_t body,
                         BenchTime t) noexcept;

/// A body's true pose as samples of kind pose. `body`: index in a WorldMotion.
[[nodiscard]] std::shared_ptr<SampleProvider> make_pose_provider(std::size_t body, std::string frame_id);

}  // namespace rigor
