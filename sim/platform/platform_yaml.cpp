#include "sim/platform/platform_yaml.h"

#include <numbers>

#include "sensor-hal/config/yaml.h"

namespace rigor {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180;
constexpr Range kPositive{.min = 0, .exclusive_min = true};
constexpr Range kNotNegative{.min = 0};

void read_suspension(ConfigNode n, Suspension& s) {
  s.frequency_hz = n.number_or("frequency_hz", s.frequency_hz, {.min = 0.1, .max = 50});
  s.damping = n.number_or("damping", s.damping, {.min = 0.01, .max = 10});
  n.finish();
}

SkidSteerConfig read_skid_steer(ConfigNode root) {
  SkidSteerConfig c;
  (void)root.text_or("name", "");
  (void)root.text_or("source", "");
  ConfigNode n = root.map_or_absent("shape");
  c.length_m = n.number_or("length_m", c.length_m, kPositive);
  c.width_m = n.number_or("width_m", c.width_m, kPositive);
  c.height_m = n.number_or("height_m", c.height_m, kPositive);
  c.wheel_radius_m = n.number_or("wheel_radius_m", c.wheel_radius_m, kPositive);
  c.wheel_width_m = n.number_or("wheel_width_m", c.wheel_width_m, kPositive);
  c.track_m = n.number_or("track_m", c.track_m, kPositive);
  c.wheelbase_m = n.number_or("wheelbase_m", c.wheelbase_m, kPositive);
  n.finish();
  n = root.map_or_absent("drive");
  c.max_speed_mps = n.number_or("max_speed_mps", c.max_speed_mps, kPositive);
  c.max_turn_radps = n.number_or("max_turn_degps", c.max_turn_radps / kRadPerDeg, kPositive) * kRadPerDeg;
  c.acceleration_mps2 = n.number_or("acceleration_mps2", c.acceleration_mps2, kPositive);
  c.braking_mps2 = n.number_or("braking_mps2", c.braking_mps2, kPositive);
  c.time_constant_s = n.number_or("time_constant_ms", c.time_constant_s * 1e3, kPositive) * 1e-3;
  c.dead_band_mps = n.number_or("dead_band_mps", c.dead_band_mps, kNotNegative);
  c.droop_s = n.number_or("droop_s", c.droop_s, {.min = 0, .max = 10});
  c.command_timeout_s = n.number_or("command_timeout_ms", c.command_timeout_s * 1e3, kNotNegative) * 1e-3;
  c.effective_track_m = n.number_or("effective_track_m", c.effective_track_m, kNotNegative);
  n.finish();
  n = root.map_or_absent("soil");
  c.slip = n.number_or("slip", c.slip, {.min = -0.5, .max = 0.95});
  c.slip_per_slope = n.number_or("slip_per_slope", c.slip_per_slope, kNotNegative);
  c.icr_ratio = n.number_or("icr_ratio", c.icr_ratio, {.min = 1, .max = 20});
  c.icr_ratio_per_radps = n.number_or("icr_ratio_per_radps", c.icr_ratio_per_radps, kNotNegative);
  c.icr_x_m = n.number_or("icr_x_m", c.icr_x_m);
  c.icr_x_per_slope_m = n.number_or("icr_x_per_slope_m", c.icr_x_per_slope_m);
  c.sideslip = n.number_or("sideslip", c.sideslip, kNotNegative);
  c.slip_events_per_s = n.number_or("slip_events_per_s", c.slip_events_per_s, {.min = 0, .max = 2});
  c.slip_event = n.number_or("slip_event", c.slip_event, {.min = 0, .max = 0.95});
  n.finish();
  n = root.map_or_absent("limits");
  c.tip_roll_rad = n.number_or("roll_deg", c.tip_roll_rad / kRadPerDeg, kPositive) * kRadPerDeg;
  c.tip_pitch_rad = n.number_or("pitch_deg", c.tip_pitch_rad / kRadPerDeg, kPositive) * kRadPerDeg;
  n.finish();
  n = root.map_or_absent("battery");
  c.mass_kg = n.number_or("mass_kg", c.mass_kg, kPositive);
  c.rolling_resistance = n.number_or("rolling_resistance", c.rolling_resistance, kNotNegative);
  c.efficiency = n.number_or("efficiency", c.efficiency, {.min = 0, .max = 1, .exclusive_min = true});
  c.idle_w = n.number_or("idle_w", c.idle_w, kNotNegative);
  c.battery_wh = n.number_or("capacity_wh", c.battery_wh, kPositive);
  n.finish();
  read_suspension(root.map_or_absent("suspension"), c.suspension);
  c.step = seconds_from(root.number_or("step_ms", c.step.seconds() * 1e3, {.min = 0.1, .max = 20}) * 1e-3);
  root.finish();
  return c;
}

}  // namespace

Result<SkidSteerConfig> load_skid_steer(const std::filesystem::path& sheet) {
  auto root = ConfigDocument::load(sheet);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] { return read_skid_steer(*root); });
}

}  // namespace rigor
