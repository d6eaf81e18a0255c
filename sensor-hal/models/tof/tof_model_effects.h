// The effects of a time-of-flight camera by name.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::models {

/// lens, vignetting, wiggling_bias, sine_like_noise, trembling, fixed_pattern, range_offset,
/// amplitude_error, flying_pixels, motion, multipath, ambient, quantisation, saturation, limits, filters.
[[nodiscard]] std::vector<std::string_view> tof_effects();
/// The camera with these alone; its modulation, and so the range where it wraps, stays. bad_input: an unknown
/// name, with all that there are. Setup.
[[nodiscard]] Result<TofModel> only_effects(const TofModel& model, std::span<const std::string> names);

}  // namespace rigor::models
