// Bridge `ros2`: channels of a rig as topics of ROS 2 over DDS (Cyclone DDS), and commands of ROS 2 nodes to
// sinks of the rig (docs/ros2.md).
//
// Keys, all optional:
//   domain: 0, interface: lo, peers: []     which network (settings.h)
//   namespace: ""            put before each topic that leaves (/rig1), but for /tf, /clock and their like
//   channels: [left, lidar]  whose samples leave; all
//   qos: reliable            sensor_data, reliable or transient_local, of what leaves; depth
//   topics:                  by patterns, the last that fits holds
//     /left/*: { qos: reliable, depth: 20 }
//     /rigor/*: { send: false }
//   commands: { /cmd_vel: {…} }             incoming.h
//   wait_for: [/left/image]  topics that a run waits for: each has a peer before it begins
//   wait_s: 30               at most; then the run fails
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] NamedBridge ros2_bridge();
/// Backend `ros2`: topics of a robot as channels (ros2_source.h).
[[nodiscard]] Backend ros2_backend();

}  // namespace rigor
