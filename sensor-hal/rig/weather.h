// The weather of a rig, `simulation.weather`: a preset by its name, or attributes of the world's Atmosphere
// one by one.
//
//   weather: fog
//   weather: { fog_visibility_m: 120, wetness: 1 }
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Attributes of an Atmosphere by their names in the world, in place of its own.
using Weather = std::vector<std::pair<std::string, double>>;

/// world, clear, overcast, fog, rain, snow.
[[nodiscard]] const std::vector<std::string>& weather_presets();
/// The attributes that a preset sets, the same ones for each; empty for `world`. `preset` is one of
/// weather_presets().
[[nodiscard]] Weather weather_preset(const std::string& preset);

/// `weather` of a rig's `simulation`; empty where there is none. Throws ConfigError. Setup context.
[[nodiscard]] Weather read_weather(const ConfigNode& simulation);

}  // namespace rigor
