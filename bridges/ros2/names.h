// How ROS 2 names topics and types on DDS (design.ros2.org/articles/topic_and_service_names.html).
#pragma once

#include <string>
#include <string_view>

namespace rigor::ros2 {

/// `/left/image` → `rt/left/image`.
[[nodiscard]] inline std::string dds_topic(std::string_view ros_topic) {
  return "rt" + std::string(ros_topic.starts_with('/') ? "" : "/") + std::string(ros_topic);
}

/// `sensor_msgs/msg/Image` or `sensor_msgs/Image` → `sensor_msgs::msg::dds_::Image_`. Empty: no name of a
/// message type.
[[nodiscard]] inline std::string dds_type(std::string_view ros_type) {
  const std::size_t first = ros_type.find('/'), last = ros_type.rfind('/');
  if (first == std::string_view::npos || first == 0 || last + 1 == ros_type.size()) return {};
  if (first != last && ros_type.substr(first, last - first + 1) != "/msg/") return {};
  return std::string(ros_type.substr(0, first)) + "::msg::dds_::" + std::string(ros_type.substr(last + 1)) +
         "_";
}

/// The same type with the folder that ROS 2 has in it: `sensor_msgs/Image` → `sensor_msgs/msg/Image`.
[[nodiscard]] inline std::string full_type(std::string_view ros_type) {
  const std::size_t first = ros_type.find('/');
  if (first == std::string_view::npos || first != ros_type.rfind('/')) return std::string(ros_type);
  return std::string(ros_type.substr(0, first)) + "/msg" + std::string(ros_type.substr(first));
}

/// ROS 2 allows letters, digits, `_` and `/` in topics; of the names of a rig only `-` is something else.
[[nodiscard]] inline std::string ros_topic(std::string topic) {
  for (char& c : topic)
    if (c == '-') c = '_';
  return topic;
}

}  // namespace rigor::ros2
