#include "sensor-hal/models/camera_effects.h"

#include "sensor-hal/models/effect_switches.h"

namespace rigor {
namespace {

using Switch = models::EffectSwitch<CameraModel>;
constexpr Switch kSwitches[] = {
    {"lens",
     [](CameraModel& m) {
       m.lens = {};
       m.fisheye = {};
     }},
    {"chromatic", [](CameraModel& m) { m.chromatic = {}; }},
    {"depth_of_field", [](CameraModel& m) { m.depth_of_field = {}; }},
    {"vignetting", [](CameraModel& m) { m.vignetting = {}; }},
    {"motion_blur", [](CameraModel& m) { m.shutter.motion_blur = false; }},
    {"rolling_shutter", [](CameraModel& m) { m.shutter.line_time_s = 0; }},
    {"bloom", [](CameraModel& m) { m.bloom.fraction = 0; }},
    {"glare", [](CameraModel& m) { m.bloom.veiling_glare = 0; }},
    {"shot_noise", [](CameraModel& m) { m.noise.shot_noise = false; }},
    {"read_noise", [](CameraModel& m) { m.noise.read_noise_e = 0; }},
    {"dark_current", [](CameraModel& m) { m.noise.dark_current_e_per_s = 0; }},
    {"dsnu", [](CameraModel& m) { m.noise.dsnu_e = 0; }},
    {"prnu", [](CameraModel& m) { m.noise.prnu = 0; }},
    {"hot_pixels", [](CameraModel& m) { m.noise.hot_pixel_share = 0; }},
    {"response", [](CameraModel& m) { m.noise.response_c2 = m.noise.response_c3 = 0; }},
    {"processing", [](CameraModel& m) { m.processing = {}; }},
};

}  // namespace

std::vector<std::string_view> camera_effects() {
  std::vector<std::string_view> names;
  for (const Switch& s : kSwitches) names.push_back(s.name);
  return names;
}

Result<CameraModel> only_effects(const CameraModel& model, std::span<const std::string> names) {
  return models::only_effects_of<CameraModel>(kSwitches, model, names);
}

}  // namespace rigor
