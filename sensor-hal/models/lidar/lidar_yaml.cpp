#include "sensor-hal/models/lidar/lidar_yaml.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/models/calibration_section.h"

namespace rigor {
namespace {

using namespace models;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kTurn = 2 * std::numbers::pi;
constexpr Range kNotNegative{.min = 0};
constexpr Range kPositive{.min = 0, .exclusive_min = true};

std::vector<LidarBeam> read_beams(ConfigNode n) {
  struct Column {
    const char* key;
    double LidarBeam::*field;
    double unit;
    Range range;
  };
  const Column columns[] = {
      {"elevation_deg", &LidarBeam::elevation_rad, kDegree, {.min = -90, .max = 90}},
      {"azimuth_deg", &LidarBeam::azimuth_rad, kDegree, {.min = -360, .max = 360}},
      {"vertical_offset_mm", &LidarBeam::vertical_offset_m, 1e-3, {.min = -1e4, .max = 1e4}},
      {"horizontal_offset_mm", &LidarBeam::horizontal_offset_m, 1e-3, {.min = -1e4, .max = 1e4}},
      {"radial_offset_mm", &LidarBeam::radial_offset_m, 1e-3, {.min = -1e4, .max = 1e4}},
      {"fire_us", &LidarBeam::fire_time_s, 1e-6, {.min = 0, .max = 1e6}},
      {"bias_mm", &LidarBeam::range_bias_m, 1e-3, {.min = -1e5, .max = 1e5}},
      {"remission_gain", &LidarBeam::remission_gain, 1, {.min = 0, .max = 1e6}},
  };
  std::vector<LidarBeam> beams(1);
  std::size_t count = 1;
  for (const Column& c : columns) {
    if (!n.has(c.key)) continue;
    const std::vector<ConfigNode> values = n.list(c.key);
    if (values.empty() || values.size() > kMaxLidarBeams)
      throw n.error(c.key, "expected a list of 1 to " + std::to_string(kMaxLidarBeams) + " numbers, got " +
                               std::to_string(values.size()));
    if (values.size() > 1 && count > 1 && values.size() != count)
      throw n.error(c.key, "expected one number or as many as the other lists, " + std::to_string(count) +
                               ", got " + std::to_string(values.size()));
    if (values.size() > 1 && count == 1) {
      count = values.size();
      beams.assign(count, beams.front());
    }
    for (std::size_t i = 0; i < count; ++i)
      beams[i].*c.field = values[values.size() > 1 ? i : 0].as_number(c.range) * c.unit;
  }
  n.finish();
  return beams;
}

void read_rotor(ConfigNode n, LidarScan& s) {
  const double rate_hz = n.number("rotation_hz", {.min = 1e-3, .max = 1e4});
  const bool clockwise =
      n.choice_or("direction", {"anticlockwise", "clockwise"}, "anticlockwise") == "clockwise";
  const double sign = clockwise ? -1 : 1;
  s.rotation_radps = sign * kTurn * rate_hz;
  const double start_deg = n.number_or("start_deg", 0, {.min = -720, .max = 720});
  const double end_deg = n.number_or("end_deg", start_deg + sign * 360, {.min = -720, .max = 720});
  s.start_azimuth_rad = start_deg * kDegree;
  const double span_deg = sign * (end_deg - start_deg);
  if (!(span_deg >= 0) || span_deg > 360)
    throw n.error("end_deg",
                  "expected an angle up to 360 degrees after start_deg in the direction of turning, got " +
                      std::to_string(end_deg));
  if (n.has("step_deg") == n.has("column_us")) throw n.error("", "expected either step_deg or column_us");
  double step_deg = 0;
  if (n.has("step_deg")) {
    step_deg = n.number("step_deg", {.min = 1e-4, .max = 360, .exclusive_min = true});
    s.column_period_s = step_deg / 360 / rate_hz;
  } else {
    s.column_period_s = n.number("column_us", kPositive) * 1e-6;
    step_deg = s.column_period_s * rate_hz * 360;
  }
  // A thousandth of a step for angles that decimals cannot state.
  const double steps = std::floor(span_deg / step_deg + 1e-3);
  const bool closes = span_deg >= 360 - 1e-9 && std::abs(steps * step_deg - 360) < 1e-3 * step_deg;
  const double columns = closes ? steps : steps + 1;
  if (!(columns <= static_cast<double>(kMaxLidarFirings)))
    throw n.error("", "expected at most " + std::to_string(kMaxLidarFirings) + " columns a scan");
  s.columns = static_cast<std::uint32_t>(columns);
}

void read_rosette(ConfigNode n, LidarScan& s) {
  const double pulses_hz = n.number("pulse_rate_hz", {.min = 1, .max = 1e8});
  const double scan_s = n.number("scan_ms", {.min = 0, .max = 2000, .exclusive_min = true}) * 1e-3;
  s.column_period_s = 1 / pulses_hz;
  const double columns = std::max(1.0, std::round(scan_s * pulses_hz));
  if (!(columns <= static_cast<double>(kMaxLidarFirings)))
    throw n.error("", "expected at most " + std::to_string(kMaxLidarFirings) + " pulses a scan");
  s.columns = static_cast<std::uint32_t>(columns);
  ConfigNode p = n.map("prisms");
  const auto pair = [&](const char* key, double unit, std::array<double, 2> fallback) {
    const auto v = p.numbers_or(key, {fallback[0] / unit, fallback[1] / unit});
    return std::array<double, 2>{v[0] * unit, v[1] * unit};
  };
  s.prisms.wedge_rad = pair("wedge_deg", kDegree, s.prisms.wedge_rad);
  s.prisms.rotation_radps = pair("rotation_hz", kTurn, s.prisms.rotation_radps);
  s.prisms.phase_rad = pair("phase_deg", kDegree, s.prisms.phase_rad);
  s.prisms.index = p.number_or("index", s.prisms.index, {.min = 1, .max = 4});
  p.finish();
}

void read_pattern(ConfigNode n, LidarScan& s) {
  const auto scan_ns = static_cast<std::int64_t>(
      std::llround(n.number("scan_ms", {.min = 0, .max = 2000, .exclusive_min = true}) * 1e6));
  ConfigNode p = n.map("pattern");
  if (p.has("file") == p.has("formula")) throw p.error("", "expected either file or formula");
  if (p.has("formula")) {
    (void)p.choice("formula", {"livox_mid360"});
    s = formula_scan(PatternFormula::livox_mid360, scan_ns);
  } else {
    auto table = load_scan_pattern(p.base_dir() / p.text("file"));
    if (!table) throw p.error("file", table.error().text());
    if (p.flag_or("periodic", false)) {
      const double period_ms =
          p.number_or("period_ms", 0, {.min = 0, .max = 1e8, .exclusive_min = p.has("period_ms")});
      if (auto set = set_period(*table, static_cast<std::int64_t>(std::llround(period_ms * 1e6))); !set)
        throw p.error("period_ms", set.error().message);
    }
    s = table_scan(std::make_shared<PatternTable>(std::move(*table)), scan_ns);
    if (s.columns > kMaxLidarFirings)
      throw n.error("scan_ms", "expected at most " + std::to_string(kMaxLidarFirings) + " firings a scan");
  }
  p.finish();
}

void read_scan(ConfigNode n, LidarScan& s) {
  const std::string kind = n.choice_or("kind", {"rotor", "rosette", "pattern"}, "rotor");
  if (kind == "pattern")
    read_pattern(n, s);
  else if (kind == "rosette")
    s.kind = LidarScanKind::rosette, read_rosette(n, s);
  else
    read_rotor(n, s);
  s.instants = static_cast<int>(n.integer_or("instants", s.instants, {.min = 1, .max = 1000}));
  n.finish();
}

void read_optics(ConfigNode root, LidarModel& m) {
  ConfigNode f = root.map_or_absent("footprint");
  if (f.has("divergence_mrad")) {
    const std::vector<ConfigNode> values = f.list("divergence_mrad");
    if (values.empty() || values.size() > 2)
      throw f.error("divergence_mrad", "expected [horizontal, vertical] or [both], got a list of " +
                                           std::to_string(values.size()));
    m.footprint.horizontal_divergence_rad = values.front().as_number({.min = 0, .max = 500}) * 1e-3;
    m.footprint.vertical_divergence_rad = values.back().as_number({.min = 0, .max = 500}) * 1e-3;
  }
  m.footprint.start_diameter_m = f.number_or("start_diameter_mm", 0, {.min = 0, .max = 1000}) * 1e-3;
  m.footprint.profile = f.choice_or("profile", {"gaussian", "top_hat"}, "gaussian") == "gaussian"
                            ? LidarProfile::gaussian
                            : LidarProfile::top_hat;
  m.footprint.sub_rays = static_cast<int>(f.integer_or("sub_rays", 1, {.min = 1, .max = kMaxLidarSubRays}));
  m.footprint.most_sub_rays =
      static_cast<int>(f.integer_or("most_sub_rays", 0, {.min = 0, .max = kMaxLidarSubRays}));
  f.finish();

  ConfigNode e = root.map_or_absent("echoes");
  m.echoes.separation_m = e.number_or("separation_m", 0, {.min = 0, .max = 1000});
  const std::vector<std::string> words{"strongest", "first", "last", "dual"};
  const std::string returns = e.choice_or("returns", words, "strongest");
  m.echoes.returns =
      static_cast<LidarReturns>(std::find(words.begin(), words.end(), returns) - words.begin());
  e.finish();

  ConfigNode d = root.map_or_absent("detection");
  m.detection.minimum_remission = d.number_or("minimum_remission", 0, {.min = 0, .max = 1000});
  m.detection.limit_remission = d.number_or("limit_remission", 0, {.min = 0, .max = 1000});
  m.detection.limit_range_m = d.number_or("limit_range_m", 0, {.min = 0, .max = 1e5});
  m.detection.overlap_m = d.number_or("overlap_m", 0, {.min = 0, .max = 1e4});
  d.finish();
}

void read_numbers(ConfigNode root, LidarModel& m) {
  ConfigNode r = root.map("range");
  m.range.min_m = r.number_or("min_m", 0, {.min = 0, .max = 1e5});
  m.range.max_m = r.number("max_m", {.min = 1e-3, .max = 1e5});
  m.range.step_m = r.number_or("step_mm", 0, {.min = 0, .max = 1e4}) * 1e-3;
  m.range.bias_m = r.number_or("bias_mm", 0, {.min = -1e5, .max = 1e5}) * 1e-3;
  m.range.scale = r.number_or("scale", 1, {.min = 0.1, .max = 10});
  m.range.remission_bias_m = r.number_or("remission_bias_mm", 0, {.min = -1e5, .max = 1e5}) * 1e-3;
  m.range.incidence_bias_m = r.number_or("incidence_bias_mm", 0, {.min = -1e5, .max = 1e5}) * 1e-3;
  m.range.housing_m = r.number_or("housing_m", 0, {.min = 0, .max = 100});
  r.finish();

  ConfigNode n = root.map_or_absent("noise");
  m.noise.floor_m = n.number_or("floor_mm", 0, {.min = 0, .max = 1e5}) * 1e-3;
  m.noise.scale_m = n.number_or("scale_mm", 0, {.min = 0, .max = 1e5}) * 1e-3;
  m.noise.offset = n.number_or("offset", 0, kNotNegative);
  m.noise.exponent = n.number_or("exponent", m.noise.exponent, {.min = 0, .max = 8});
  m.noise.reference_range_m = n.number_or("reference_range_m", 0, {.min = 0, .max = 1e5});
  m.noise.retro_sigma_m = n.number_or("retro_sigma_mm", 0, {.min = 0, .max = 1e5}) * 1e-3;
  n.finish();

  ConfigNode i = root.map_or_absent("remission");
  m.remission.scale = i.number_or("scale", m.remission.scale, {.min = 0, .max = 1e9});
  m.remission.retro_scale = i.number_or("retro_scale", m.remission.scale, {.min = 0, .max = 1e9});
  m.remission.range_exponent = i.number_or("range_exponent", 0, {.min = 0, .max = 8});
  m.remission.reference_range_m = i.number_or("reference_range_m", 0, {.min = 0, .max = 1e5});
  m.remission.noise = i.number_or("noise", 0, {.min = 0, .max = 10});
  m.remission.maximum = i.number_or("maximum", 0, {.min = 0, .max = 1e9});
  m.remission.step = i.number_or("step", 0, {.min = 0, .max = 1e6});
  i.finish();
}

void read_surroundings(ConfigNode root, LidarModel& m) {
  ConfigNode r = root.map_or_absent("retro");
  m.retro.gain = r.number_or("gain", m.retro.gain, {.min = 0, .max = 1e6});
  m.retro.crosstalk = r.number_or("crosstalk", 0, {.min = 0, .max = 1});
  m.retro.crosstalk_beams = static_cast<int>(r.integer_or("crosstalk_beams", 1, {.min = 0, .max = 16}));
  m.retro.crosstalk_columns = static_cast<int>(r.integer_or("crosstalk_columns", 1, {.min = 0, .max = 16}));
  r.finish();

  ConfigNode s = root.map_or_absent("sun");
  m.sun.half_angle_rad = s.number_or("half_angle_deg", 0, {.min = 0, .max = 180}) * kDegree;
  m.sun.gain_m2_per_w = s.number_or("gain_m2_per_w", 0, {.min = 0, .max = 1e12});
  s.finish();

  ConfigNode a = root.map_or_absent("air");
  m.air.drop_reflectance = a.number_or("drop_reflectance", 0, {.min = 0, .max = 1});
  m.air.lidar_ratio_sr = a.number_or("lidar_ratio_sr", 0, {.min = 0, .max = 1e4});
  m.air.pulse_length_m = a.number_or("pulse_length_m", 0, {.min = 0, .max = 100});
  a.finish();
}

}  // namespace

Result<LidarModel> parse_lidar_model(ConfigNode root) {
  auto model = catch_config([&] {
    LidarModel m;
    m.wavelength_nm = root.number_or("wavelength_nm", m.wavelength_nm, {.min = 300, .max = 2500});
    m.scan.beams = read_beams(root.map_or_absent("beams"));
    read_scan(root.map("scan"), m.scan);
    if (m.scan.kind == LidarScanKind::pattern && root.has("beams"))
      throw root.error("beams", "expected none: a pattern says itself where each firing points");
    read_optics(root, m);
    read_numbers(root, m);
    read_surroundings(root, m);
    (void)read_calibration(root);
    root.finish();
    return m;
  });
  if (!model) return model;
  if (auto valid = model->validate(); !valid) {
    Error e = valid.error();
    e.where = root.place() + (e.where.empty() ? "" : ": " + e.where);
    return tl::unexpected<Error>(std::move(e));
  }
  return model;
}

Result<LidarModel> load_lidar_model(const std::filesystem::path& file, std::uint64_t draw) {
  auto root = load_sensor_model(file, draw);
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_lidar_model(*root);
}

}  // namespace rigor
