// A camera's model as ROS 2 tells it.
#pragma once

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {

/// `rational_polynomial` or, for fisheyes, `equidistant`; the header is empty.
[[nodiscard]] record::msg::CameraInfo camera_info(const CameraModel& model);

}  // namespace rigor
