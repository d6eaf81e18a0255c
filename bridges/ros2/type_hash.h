// The hash of a message type, RIHS01, by which ROS 2 (Iron and newer) tells whether two sides mean the same
// by a type's name: SHA-256 of the type's description as JSON, without default values and comments.
// Source: REP-2016 and `calculate_type_hash` of rosidl_generator_type_description.
#pragma once

#include <string>

#include "bridges/ros2/definition.h"

namespace rigor::ros2 {

/// `RIHS01_` and 64 hexadecimal digits. Errors: unavailable, no SHA-256. Any thread; allocates.
[[nodiscard]] Result<std::string> type_hash(const Definition& definition);

}  // namespace rigor::ros2
