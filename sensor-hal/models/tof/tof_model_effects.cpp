#include "sensor-hal/models/tof/tof_model_effects.h"

#include "sensor-hal/models/effect_switches.h"

namespace rigor::models {
namespace {

using Switch = EffectSwitch<TofModel>;
constexpr double kBottomlessWell_e = 1e12;
constexpr Switch kSwitches[] = {
    {"lens", [](TofModel& m) { m.lens = {}; }},
    {"vignetting", [](TofModel& m) { m.optics.cos4_weight = 0; }},
    {"wiggling_bias", [](TofModel& m) { m.modulation.wiggling_bias = false; }},
    {"sine_like_noise", [](TofModel& m) { m.modulation.sine_like_noise = false; }},
    {"trembling", [](TofModel& m) { m.pixel.trembling = false; }},
    {"fixed_pattern",
     [](TofModel& m) {
       m.pixel.range_offset_sigma_m = 0;
       m.pixel.gain_sigma = 0;
     }},
    {"range_offset", [](TofModel& m) { m.range_error.offset_m = 0; }},
    {"amplitude_error", [](TofModel& m) { m.range_error.amplitude_error_m_e = 0; }},
    {"flying_pixels",
     [](TofModel& m) {
       m.sampling.samples = 1;
       m.sampling.bilinear = false;
     }},
    {"motion", [](TofModel& m) { m.sampling.motion = false; }},
    {"multipath", [](TofModel& m) { m.sampling.multipath_rays = 0; }},
    {"ambient", [](TofModel& m) { m.optics.filter_width_m = 0; }},
    {"quantisation", [](TofModel& m) { m.pixel.adc_bits = 0; }},
    {"saturation",
     [](TofModel& m) {
       // The converter's step hangs on the well: where it rounds, the well stays.
       if (m.pixel.adc_bits == 0) m.pixel.full_well_e = kBottomlessWell_e;
     }},
    {"limits",
     [](TofModel& m) {
       m.limits = {};
       m.modulation.unwrap_tolerance_m = 0;
     }},
    {"filters", [](TofModel& m) { m.filters = {}; }},
};

}  // namespace

std::vector<std::string_view> tof_effects() {
  std::vector<std::string_view> names;
  for (const Switch& s : kSwitches) names.push_back(s.name);
  return names;
}

Result<TofModel> only_effects(const TofModel& model, std::span<const std::string> names) {
  return only_effects_of<TofModel>(kSwitches, model, names);
}

}  // namespace rigor::models
