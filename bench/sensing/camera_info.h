// A camera's model as ROS 2 tells it.
#pragma once

#include <optional>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// `plumb_bob` (k1, k2, p1, p2, k3), `rational_polynomial` where the lens has k4 to k6 too, or, for fisheyes,
/// `equidistant`. R is the identity and P that of a camera alone; the header is empty.
[[nodiscard]] record::msg::CameraInfo camera_info(const CameraModel& model);

/// R and P of two cameras that look side by side (sensor_msgs/CameraInfo): R turns each camera's axes into
/// those of the rectified pair, whose x axis is the baseline and whose z axis the mean of the optical ones as
/// far as that is square to it (Fusiello, Trucco and Verri 2000, equations 8 and 9). Both get the same focal
/// length (the mean of the left one's) and the same principal point (that of the left one); P of the right
/// one has Tx = -f · baseline.
struct StereoCameraInfo {
  record::msg::CameraInfo left, right;
};
/// `T_left_right`: the right optical frame in the left one. Empty where the baseline is shorter than 1 mm, or
/// lies along the optical axes.
[[nodiscard]] std::optional<StereoCameraInfo> stereo_camera_info(const CameraModel& left,
                                                                 const CameraModel& right,
                                                                 const Pose& T_left_right);

}  // namespace rigor
