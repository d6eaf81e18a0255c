#include "sensor-hal/rig/weather.h"

#include <limits>
#include <map>

namespace rigor {
namespace {

/// Weather by the keys of rigs.
Weather read_attributes(const ConfigNode& n) {
  struct Key {
    const char *key, *attribute;
    Range range;
  };
  static const Key kKeys[] = {{"visibility_m", "visibility_m", {.min = 1}},
                              {"fog_visibility_m", "fog_visibility_m", {.min = 1}},
                              {"fog_top_m", "fog_top_m", {}},
                              {"rain_mmph", "rain_mm_per_h", {.min = 0, .max = 500}},
                              {"snow_mmph", "snow_mm_per_h", {.min = 0, .max = 100}},
                              {"snow_depth_m", "snow_depth_m", {.min = 0, .max = 20}},
                              {"wetness", "wetness", {.min = 0, .max = 1}},
                              {"cloud_cover", "cloud_cover", {.min = 0, .max = 1}}};
  Weather out;
  for (const Key& k : kKeys)
    if (n.has(k.key)) out.emplace_back(k.attribute, n.number(k.key, k.range));
  // All keys are known to `finish`, so that it can name the nearest.
  for (const Key& k : kKeys) (void)n.number_or(k.key, k.range.min > 0 ? k.range.min : 0);
  n.finish();
  return out;
}

}  // namespace

const std::vector<std::string>& weather_presets() {
  static const std::vector<std::string> kPresets{"world", "clear", "overcast", "fog", "rain", "snow"};
  return kPresets;
}

Weather weather_preset(const std::string& preset) {
  if (preset == "world") return {};
  std::map<std::string, double> a{
      {"cloud_cover", 0},   {"fog_visibility_m", std::numeric_limits<double>::infinity()},
      {"rain_mm_per_h", 0}, {"snow_mm_per_h", 0},
      {"snow_depth_m", 0},  {"wetness", 0}};
  if (preset != "clear") a["cloud_cover"] = 1;
  if (preset == "fog") a["fog_visibility_m"] = 80;
  if (preset == "rain") a["rain_mm_per_h"] = 8, a["wetness"] = 1;
  if (preset == "snow") a["snow_mm_per_h"] = 1, a["snow_depth_m"] = 0.1;
  return {a.begin(), a.end()};
}

Weather read_weather(const ConfigNode& simulation) {
  if (!simulation.scalar_or_empty("weather").empty())
    return weather_preset(simulation.choice("weather", weather_presets()));
  const ConfigNode weather = simulation.map_or_absent("weather");
  return weather.present() ? read_attributes(weather) : Weather{};
}

}  // namespace rigor
