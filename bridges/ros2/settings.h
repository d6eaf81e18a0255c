// Keys that a bridge and a source of ROS 2 have in common.
//
//   domain: 0            ROS_DOMAIN_ID of the others
//   interface: lo        of the network, by name or address; auto: as Cyclone DDS chooses
//   peers: []            addresses of machines that multicast does not reach
#pragma once

#include "bridges/ros2/participant.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::ros2 {

/// Throw ConfigError.
[[nodiscard]] DomainSettings read_domain(const ConfigNode& n);
/// `qos: sensor_data`, `depth: 5`, where one of them is there.
[[nodiscard]] Qos read_qos(const ConfigNode& n, Qos fallback);
/// A topic of ROS 2, `/camera/image_raw`, at this key or, with an empty key, at the node's own place.
void check_topic(const ConfigNode& n, std::string_view key, const std::string& topic);

}  // namespace rigor::ros2
