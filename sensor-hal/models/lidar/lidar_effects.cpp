#include "sensor-hal/models/lidar/lidar_effects.h"

#include "sensor-hal/models/effect_switches.h"

namespace rigor::models {
namespace {

using Switch = EffectSwitch<LidarModel>;
constexpr Switch kSwitches[] = {
    {"footprint", [](LidarModel& m) { m.footprint.sub_rays = 1, m.footprint.most_sub_rays = 0; }},
    // What the receiver tells apart stays: without it each sub-ray of a footprint would be an echo of its
    // own.
    {"echoes", [](LidarModel& m) { m.echoes.returns = LidarReturns::strongest; }},
    {"detection", [](LidarModel& m) { m.detection = {}; }},
    {"range_noise", [](LidarModel& m) { m.noise = {}; }},
    {"beam_bias",
     [](LidarModel& m) {
       m.range.bias_m = m.range.remission_bias_m = m.range.incidence_bias_m = 0;
       m.range.scale = 1;
       for (LidarBeam& beam : m.scan.beams) beam.range_bias_m = 0;
     }},
    {"beam_gain",
     [](LidarModel& m) {
       for (LidarBeam& beam : m.scan.beams) beam.remission_gain = 1;
     }},
    {"remission_noise", [](LidarModel& m) { m.remission.noise = 0; }},
    {"remission_scale",
     [](LidarModel& m) {
       m.remission.retro_scale = 0;
       m.remission.range_exponent = 0;
       m.remission.maximum = 0;
     }},
    {"quantisation",
     [](LidarModel& m) {
       m.range.step_m = 0;
       m.remission.step = 0;
     }},
    {"crosstalk", [](LidarModel& m) { m.retro.crosstalk = 0; }},
    {"sun", [](LidarModel& m) { m.sun = {}; }},
    {"air", [](LidarModel& m) { m.air = {}; }},
};

}  // namespace

std::vector<std::string_view> lidar_effects() {
  std::vector<std::string_view> names;
  for (const Switch& s : kSwitches) names.push_back(s.name);
  return names;
}

Result<LidarModel> only_effects(const LidarModel& model, std::span<const std::string> names) {
  return only_effects_of<LidarModel>(kSwitches, model, names);
}

}  // namespace rigor::models
