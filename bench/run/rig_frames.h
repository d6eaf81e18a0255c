// The frames of a rig: which there are, and where they stand in each other (sensor-hal/record/frame_tree.h).
//
//   world ─┬─ robot (moves with the platform) ─┬─ robot.boom (turns) ─ left ─ left_optical
//          │                                   └─ imu
//          ├─ turntable (a hinged node of the world)
//          ├─ odom (where the platform with the odometry starts)
//          └─ right ─ right_optical
//
// A sensor's frame is that of its headers (ChannelDescription::frame_id). Where it sits is said, in this
// order, by `frames.mounts`, by its channel (T_world_sensor, or parent and T_parent_sensor; of a pair the
// simulated side), or by the emulator that stands for its device. A sensor of which nobody says so is put at
// the root's origin, so that 3D views show it, and is named in FramesOfRig::assumed.
//
// Odometry is in the frame `odom`, which is put where its platform starts; its own frame is the platform's
// base. So the tree tells the true places, and the odometry's poses show its drift.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bench/run/bench_run.h"
#include "bench/sensing/simulation.h"
#include "sensor-hal/record/frame_tree.h"

namespace rigor {

struct FramesOfRig {
  record::FrameTree tree;
  std::vector<std::string> assumed;  ///< sensors' frames of which nobody says where they are
};

/// Setup context, after the channels are configured. `simulation`: null where the rig has no world. bad_input
/// with place: `frames.mounts` of a frame that no sensor has, or on a parent that is not there.
[[nodiscard]] Result<FramesOfRig> frames_of(const RigConfig& rig,
                                            const std::vector<std::unique_ptr<RunChannel>>& channels,
                                            const Simulation* simulation);

}  // namespace rigor
