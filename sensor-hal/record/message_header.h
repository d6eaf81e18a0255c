// The std_msgs/Header that a message begins with, whatever its type is. Any thread.
#pragma once

#include <optional>

#include "sensor-hal/record/ros2_messages.h"

namespace rigor::record {

/// Empty where the bytes do not begin with a header as CDR of either byte order. Who calls it knows that the
/// type's first field is one.
[[nodiscard]] std::optional<msg::Header> read_header(Bytes message);

}  // namespace rigor::record
