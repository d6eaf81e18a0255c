// The effects of a LiDAR by name.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"

namespace rigor::models {

/// footprint, echoes, detection, range_noise, beam_bias, beam_gain, remission_noise, remission_scale,
/// quantisation, crosstalk, sun, air.
[[nodiscard]] std::vector<std::string_view> lidar_effects();
/// The LiDAR with these alone; its scan and its limits of range stay. bad_input: an unknown name, with all
/// that there are. Setup.
[[nodiscard]] Result<LidarModel> only_effects(const LidarModel& model, std::span<const std::string> names);

}  // namespace rigor::models
