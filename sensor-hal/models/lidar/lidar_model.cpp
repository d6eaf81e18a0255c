#include "sensor-hal/models/lidar/lidar_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/philox.h"

namespace rigor::models {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Bound {
  const char* key;
  double value;
  double min = 0, max = kInfinity;
};

std::string shown(double v) {
  std::string s = std::to_string(v);
  return s;
}

Status check(const Bound& b) {
  // Not a number fails both comparisons; infinity is no value of a model.
  if (std::isfinite(b.value) && b.value >= b.min && b.value <= b.max) return {};
  std::string expected = "expected a number from " + shown(b.min);
  if (b.max < kInfinity) expected += " to " + shown(b.max);
  return fail(ErrorCode::bad_input, b.key, expected + ", got " + shown(b.value));
}

Status check_beam(const LidarBeam& b) {
  for (const Bound& bound : {Bound{"beams.elevation", b.elevation_rad, -kPi / 2, kPi / 2},
                             {"beams.azimuth", b.azimuth_rad, -2 * kPi, 2 * kPi},
                             {"beams.vertical_offset", b.vertical_offset_m, -10, 10},
                             {"beams.horizontal_offset", b.horizontal_offset_m, -10, 10},
                             {"beams.radial_offset", b.radial_offset_m, -10, 10},
                             {"beams.fire", b.fire_time_s, 0, 10},
                             {"beams.bias", b.range_bias_m, -100, 100},
                             {"beams.remission_gain", b.remission_gain, 0, 1e6}})
    if (auto ok = check(bound); !ok) return ok;
  return {};
}

Status check_pattern(const LidarScan& s) {
  const bool table = s.pattern.table && !s.pattern.table->firings.empty();
  if (table == (s.pattern.formula != PatternFormula::none))
    return fail(ErrorCode::bad_input, "scan.pattern", "expected either a table with firings or a formula");
  if (table && s.pattern.table->periodic && s.pattern.table->period_ns <= 0)
    return fail(ErrorCode::bad_input, "scan.pattern", "expected a period of a periodic pattern, got none");
  if (s.pattern_scan_ns <= 0 || s.pattern_scan_ns > 2'000'000'000)
    return fail(ErrorCode::bad_input, "scan.scan",
                "expected a scan of more than 0 and at most 2 s, got " +
                    shown(static_cast<double>(s.pattern_scan_ns) * 1e-9) + " s");
  return {};
}

Status check_scan(const LidarScan& s) {
  if (s.beams.empty() || s.beams.size() > kMaxLidarBeams)
    return fail(
        ErrorCode::bad_input, "beams",
        "expected 1 to " + std::to_string(kMaxLidarBeams) + " beams, got " + std::to_string(s.beams.size()));
  for (const LidarBeam& b : s.beams)
    if (auto ok = check_beam(b); !ok) return ok;
  if (s.columns == 0 || s.columns * s.beams.size() > kMaxLidarFirings)
    return fail(ErrorCode::bad_input, "scan",
                "expected 1 to " + std::to_string(kMaxLidarFirings) + " firings a scan, got " +
                    std::to_string(s.columns * s.beams.size()));
  for (const Bound& bound : {Bound{"scan.column_period", s.column_period_s, 0, 10},
                             {"scan.start", s.start_azimuth_rad, -4 * kPi, 4 * kPi},
                             {"scan.rotation", s.rotation_radps, -1e5, 1e5},
                             {"scan.prisms.wedge", s.prisms.wedge_rad[0], -0.6, 0.6},
                             {"scan.prisms.wedge", s.prisms.wedge_rad[1], -0.6, 0.6},
                             {"scan.prisms.rotation", s.prisms.rotation_radps[0], -1e5, 1e5},
                             {"scan.prisms.rotation", s.prisms.rotation_radps[1], -1e5, 1e5},
                             {"scan.prisms.phase", s.prisms.phase_rad[0], -1e3, 1e3},
                             {"scan.prisms.phase", s.prisms.phase_rad[1], -1e3, 1e3},
                             {"scan.prisms.index", s.prisms.index, 1, 4},
                             {"scan.instants", static_cast<double>(s.instants), 1, 1000}})
    if (auto ok = check(bound); !ok) return ok;
  if (s.kind == LidarScanKind::pattern)
    if (auto ok = check_pattern(s); !ok) return ok;
  // Offsets of points are int32 nanoseconds.
  if (s.duration_s() > 2.0)
    return fail(ErrorCode::bad_input, "scan",
                "expected a scan of at most 2 s, got " + shown(s.duration_s()) + " s");
  return {};
}

}  // namespace

double LidarScan::last_fire_time_s() const {
  double last = 0;
  for (const LidarBeam& b : beams) last = std::max(last, b.fire_time_s);
  return last;
}

Status LidarModel::validate() const {
  if (auto ok = check_scan(scan); !ok) return ok;
  for (const Bound& bound :
       {Bound{"wavelength_nm", wavelength_nm, 300, 2500},
        {"footprint.divergence", footprint.horizontal_divergence_rad, 0, 0.5},
        {"footprint.divergence", footprint.vertical_divergence_rad, 0, 0.5},
        {"footprint.start_diameter", footprint.start_diameter_m, 0, 1},
        {"footprint.sub_rays", static_cast<double>(footprint.sub_rays), 1, kMaxLidarSubRays},
        {"footprint.most_sub_rays", static_cast<double>(footprint.most_sub_rays), 0, kMaxLidarSubRays},
        {"echoes.separation", echoes.separation_m, 0, 1000},
        {"detection.minimum_remission", detection.minimum_remission, 0, 1e3},
        {"detection.limit_remission", detection.limit_remission, 0, 1e3},
        {"detection.limit_range", detection.limit_range_m, 0, 1e5},
        {"detection.overlap", detection.overlap_m, 0, 1e4},
        {"range.min", range.min_m, 0, 1e5},
        {"range.max", range.max_m, 1e-3, 1e5},
        {"range.step", range.step_m, 0, 10},
        {"range.bias", range.bias_m, -100, 100},
        {"range.scale", range.scale, 0.1, 10},
        {"range.walk", range.remission_bias_m, -100, 100},
        {"range.oblique", range.incidence_bias_m, -100, 100},
        {"range.housing", range.housing_m, 0, 100},
        {"noise.floor", noise.floor_m, 0, 100},
        {"noise.scale", noise.scale_m, 0, 100},
        {"noise.offset", noise.offset, 0, 1e6},
        {"noise.exponent", noise.exponent, 0, 8},
        {"noise.reference_range", noise.reference_range_m, 0, 1e5},
        {"noise.retro_sigma", noise.retro_sigma_m, 0, 100},
        {"remission.scale", remission.scale, 0, 1e9},
        {"remission.retro_scale", remission.retro_scale, 0, 1e9},
        {"remission.range_exponent", remission.range_exponent, 0, 8},
        {"remission.reference_range", remission.reference_range_m, 0, 1e5},
        {"remission.noise", remission.noise, 0, 10},
        {"remission.maximum", remission.maximum, 0, 1e9},
        {"remission.step", remission.step, 0, 1e6},
        {"retro.gain", retro.gain, 0, 1e6},
        {"retro.crosstalk", retro.crosstalk, 0, 1},
        {"retro.crosstalk_beams", static_cast<double>(retro.crosstalk_beams), 0, 16},
        {"retro.crosstalk_columns", static_cast<double>(retro.crosstalk_columns), 0, 16},
        {"sun.half_angle", sun.half_angle_rad, 0, kPi},
        {"sun.gain", sun.gain_m2_per_w, 0, 1e12},
        {"air.drop_reflectance", air.drop_reflectance, 0, 1},
        {"air.lidar_ratio", air.lidar_ratio_sr, 0, 1e4},
        {"air.pulse_length", air.pulse_length_m, 0, 100}})
    if (auto ok = check(bound); !ok) return ok;
  if (footprint.most_sub_rays > 0 &&
      (footprint.sub_rays < 3 || footprint.most_sub_rays <= footprint.sub_rays))
    return fail(ErrorCode::bad_input, "footprint.most_sub_rays",
                "expected 0, or more than sub_rays and these at least 3, got " +
                    std::to_string(footprint.most_sub_rays) + " and " + std::to_string(footprint.sub_rays));
  if (!(range.min_m < range.max_m))
    return fail(ErrorCode::bad_input, "range",
                "expected min < max, got " + shown(range.min_m) + " and " + shown(range.max_m));
  if (detection.limit_remission > 0 && detection.limit_range_m <= 0)
    return fail(ErrorCode::bad_input, "detection.limit_range", "expected > 0 with a limit remission, got 0");
  if (remission.range_exponent > 0 && remission.reference_range_m <= 0)
    return fail(ErrorCode::bad_input, "remission.reference_range",
                "expected > 0 with a range exponent, got 0");
  if (noise.scale_m > 0 && noise.offset <= 0 && noise.exponent > 4)
    return fail(ErrorCode::bad_input, "noise.exponent",
                "expected at most 4 without an offset, got " + shown(noise.exponent));
  if (air.lidar_ratio_sr > 0 && air.pulse_length_m <= 0)
    return fail(ErrorCode::bad_input, "air.pulse_length", "expected > 0 with a lidar ratio, got 0");
  return {};
}

std::vector<SubRay> footprint_pattern(const LidarFootprint& footprint) {
  const int count = std::max(footprint.sub_rays, 1);
  std::vector<SubRay> rays(static_cast<std::size_t>(count));
  // Share of the profile within s² of the disc.
  const auto within = [&](double s2) {
    return footprint.profile == LidarProfile::gaussian
               ? LidarMath<double>::lidar_gaussian_share(s2) / LidarMath<double>::lidar_gaussian_share(1.0)
               : s2;
  };
  // Mean of s² in a ring by the profile, so that the footprint's width is kept.
  const auto mean_square = [&](double inner, double outer) {
    if (footprint.profile == LidarProfile::top_hat) return (inner + outer) / 2;
    const double a = std::exp(-2 * inner), b = std::exp(-2 * outer);
    return 0.5 + (inner * a - outer * b) / (a - b);
  };
  // Rings of cells of equal area around the centre's; a spiral is rings of one.
  std::vector<int> rings;
  int placed = 1;
  if (count == 5)
    rings = {4};
  else if (count == 13)
    rings = {4, 8};
  else
    for (int n = 6; placed + n <= count; n += 6) rings.push_back(n), placed += n;
  placed = 1;
  for (const int n : rings) placed += n;
  const bool spiral = placed != count;
  if (spiral) rings.assign(static_cast<std::size_t>(count - 1), 1);

  rays[0] = {0, 0, within(1.0 / count)};
  std::size_t at = 1;
  for (std::size_t ring = 0; ring < rings.size(); ++ring) {
    const int n = rings[ring];
    const double inner = static_cast<double>(at) / count,
                 outer = static_cast<double>(at + static_cast<std::size_t>(n)) / count;
    const double radius = std::sqrt(mean_square(inner, outer));
    for (int i = 0; i < n; ++i, ++at) {
      // The ring of four is turned, so that upright and level edges part the rays of a footprint five ways,
      // not three. Rings are turned against each other; the spiral turns by the golden angle.
      const double turn = count == 5 ? std::atan(0.5) : kPi / n * static_cast<double>(ring % 2);
      const double angle =
          spiral ? static_cast<double>(at) * kPi * (3 - std::sqrt(5.0)) : turn + i * 2 * kPi / n;
      rays[at] = {radius * std::cos(angle), radius * std::sin(angle), (within(outer) - within(inner)) / n};
    }
  }
  return rays;
}

SubRay footprint_ray(const LidarFootprint& footprint, std::uint32_t firing, std::uint32_t k) {
  // Roberts (2018), R2.
  constexpr double a1 = 0.7548776662466927, a2 = 0.5698402909980532;
  constexpr std::uint32_t effect = 0x46505201U;  // nobody else's
  const auto words = philox({firing, effect, 0, 0}, {});
  double whole = 0;
  const double s = std::modf(NoiseMath<double>::unit_from_bits(words[0]) + (k + 1) * a1, &whole),
               t = std::modf(NoiseMath<double>::unit_from_bits(words[1]) + (k + 1) * a2, &whole);
  const double s2 = footprint.profile == LidarProfile::gaussian ? -0.5 * std::log1p(s * std::expm1(-2.0)) : s;
  return {std::sqrt(s2) * std::cos(2 * kPi * t), std::sqrt(s2) * std::sin(2 * kPi * t), 1};
}

LidarAim rotor_aim(const LidarBeam& beam, double azimuth_rad) {
  const double a = azimuth_rad + beam.azimuth_rad, c = std::cos(a), s = std::sin(a);
  const double ce = std::cos(beam.elevation_rad), se = std::sin(beam.elevation_rad);
  return {{ce * c, ce * s, se},
          {beam.radial_offset_m * c - beam.horizontal_offset_m * s,
           beam.radial_offset_m * s + beam.horizontal_offset_m * c, beam.vertical_offset_m}};
}

LidarScan formula_scan(PatternFormula formula, std::int64_t scan_ns) {
  LidarScan s;
  s.kind = LidarScanKind::pattern;
  s.pattern.formula = formula;
  s.pattern_scan_ns = scan_ns;
  s.beams.resize(kLivoxLines);
  for (std::uint32_t i = 0; i < kLivoxLines; ++i) s.beams[i].fire_time_s = i * kLivoxFiring_s;
  s.column_period_s = kLivoxLines * kLivoxFiring_s;
  s.columns = static_cast<std::uint32_t>(
      std::max(1.0, std::round(static_cast<double>(scan_ns) * 1e-9 / s.column_period_s)));
  return s;
}

LidarScan table_scan(std::shared_ptr<const PatternTable> table, std::int64_t scan_ns) {
  LidarScan s;
  s.kind = LidarScanKind::pattern;
  s.pattern_scan_ns = scan_ns;
  s.columns = static_cast<std::uint32_t>(std::min(table->max_firings(scan_ns), kMaxLidarFirings + 1));
  s.column_period_s = static_cast<double>(table->step_ns()) * 1e-9;
  s.pattern.table = std::move(table);
  return s;
}

LidarAim rosette_aim(const LidarBeam& beam, const RisleyPrisms& prisms, double t_s) {
  LidarAim aim = rotor_aim(beam, 0);
  const auto angle = [&](std::size_t i) {
    // Whole turns are taken away in double before the sine, so that a long run loses nothing.
    return prisms.phase_rad[i] + std::fmod(prisms.rotation_radps[i] * t_s, 2 * kPi);
  };
  const std::array<double, 3> d = aim.direction;
  LidarMath<double>::lidar_risley_direction(d[0], d[1], d[2], prisms.wedge_rad[0], angle(0),
                                            prisms.wedge_rad[1], angle(1), prisms.index, aim.direction[0],
                                            aim.direction[1], aim.direction[2]);
  return aim;
}

}  // namespace rigor::models
