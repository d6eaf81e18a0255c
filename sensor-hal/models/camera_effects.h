// The effects of a camera by name.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sensor-hal/models/camera_model.h"

namespace rigor {

/// lens, chromatic, depth_of_field, vignetting, motion_blur, rolling_shutter, bloom, glare, shot_noise,
/// read_noise, dark_current, dsnu, prnu, hot_pixels, response,
/// processing.
[[nodiscard]] std::vector<std::string_view> camera_effects();
/// The camera with these alone. What is left where none is named: an ideal lens of its projection, electrons
/// without noise, and the converter. bad_input: an unknown name, with all that there are. Setup.
[[nodiscard]] Result<CameraModel> only_effects(const CameraModel& model, std::span<const std::string> names);

}  // namespace rigor
