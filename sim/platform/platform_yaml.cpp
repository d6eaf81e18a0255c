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

/// In degrees, but for what slides and grips.
void read_axis(ConfigNode n, CraneAxis& a, bool turns) {
  const double unit = turns ? kRadPerDeg : 1;
  const std::string suffix = turns ? "_deg" : "";
  a.min = n.number_or("min" + suffix, a.min / unit) * unit;
  a.max = n.number_or("max" + suffix, a.max / unit) * unit;
  a.start = n.number_or("start" + suffix, a.start / unit) * unit;
  a.rate = n.number_or(turns ? "rate_degps" : "rate_per_s", a.rate / unit, kPositive) * unit;
  a.acceleration =
      n.number_or(turns ? "acceleration_degps2" : "acceleration_per_s2", a.acceleration / unit, kPositive) *
      unit;
  if (n.present() && !(a.min <= a.start && a.start <= a.max))
    throw n.error("", "expected the start between the end stops");
  n.finish();
}

HarvesterConfig read_harvester(ConfigNode root) {
  HarvesterConfig c;
  (void)root.text_or("name", "");
  ConfigNode n = root.map_or_absent("shape");
  c.length_m = n.number_or("length_m", c.length_m, kPositive);
  c.width_m = n.number_or("width_m", c.width_m, kPositive);
  c.hull_height_m = n.number_or("hull_height_m", c.hull_height_m, kPositive);
  c.clearance_m = n.number_or("clearance_m", c.clearance_m, kPositive);
  c.wheel_radius_m = n.number_or("wheel_radius_m", c.wheel_radius_m, kPositive);
  c.wheel_width_m = n.number_or("wheel_width_m", c.wheel_width_m, kPositive);
  c.track_m = n.number_or("track_m", c.track_m, kPositive);
  c.wheelbase_m = n.number_or("wheelbase_m", c.wheelbase_m, kPositive);
  c.cabin_x_m = n.number_or("cabin_x_m", c.cabin_x_m);
  c.cabin_height_m =
      n.number_or("cabin_height_m", c.cabin_height_m, {.min = c.clearance_m + c.hull_height_m + 0.1});
  n.finish();
  n = root.map_or_absent("drive");
  c.max_speed_mps = n.number_or("max_speed_mps", c.max_speed_mps, kPositive);
  c.acceleration_mps2 = n.number_or("acceleration_mps2", c.acceleration_mps2, kPositive);
  c.time_constant_s = n.number_or("time_constant_ms", c.time_constant_s * 1e3, kPositive) * 1e-3;
  c.max_steer_rad =
      n.number_or("max_steer_deg", c.max_steer_rad / kRadPerDeg, {.min = 0, .max = 80}) * kRadPerDeg;
  c.steer_rate_radps =
      n.number_or("steer_rate_degps", c.steer_rate_radps / kRadPerDeg, kPositive) * kRadPerDeg;
  c.slip = n.number_or("slip", c.slip, {.min = -0.5, .max = 0.95});
  n.finish();
  n = root.map_or_absent("limits");
  c.tip_roll_rad = n.number_or("roll_deg", c.tip_roll_rad / kRadPerDeg, kPositive) * kRadPerDeg;
  c.tip_pitch_rad = n.number_or("pitch_deg", c.tip_pitch_rad / kRadPerDeg, kPositive) * kRadPerDeg;
  n.finish();
  read_suspension(root.map_or_absent("suspension"), c.suspension);
  n = root.map_or_absent("crane");
  const std::vector<double> foot = n.numbers_or("foot_m", {c.foot_m.x(), c.foot_m.y(), c.foot_m.z()});
  c.foot_m = {foot[0], foot[1], foot[2]};
  c.boom_m = n.number_or("boom_m", c.boom_m, kPositive);
  c.stick_m = n.number_or("stick_m", c.stick_m, kPositive);
  c.head_m = n.number_or("head_m", c.head_m, kNotNegative);
  c.reach_m = n.number_or("reach_m", c.reach_m, kPositive);
  const char* const names[] = {"slew", "boom", "stick", "telescope", "rotate", "grip"};
  const ConfigNode axes = n.map_or_absent("axes");
  for (std::size_t i = 0; i < HarvesterConfig::kAxes; ++i)
    read_axis(axes.map_or_absent(names[i]), c.axis[i],
              i != HarvesterConfig::kTelescope && i != HarvesterConfig::kGrip);
  axes.finish();
  n.finish();
  c.step = seconds_from(root.number_or("step_ms", c.step.seconds() * 1e3, {.min = 0.1, .max = 20}) * 1e-3);
  root.finish();
  return c;
}

}  // namespace

Result<HarvesterConfig> load_harvester(const std::filesystem::path& file) {
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] { return read_harvester(*root); });
}

Result<SkidSteerConfig> load_skid_steer(const std::filesystem::path& file) {
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] { return read_skid_steer(*root); });
}

}  // namespace rigor
