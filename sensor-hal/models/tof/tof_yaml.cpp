#include "sensor-hal/models/tof/tof_yaml.h"

#include <algorithm>
#include <cstdlib>

#include "sensor-hal/models/calibration_section.h"

namespace rigor {
namespace {

using models::TofModel;
using models::TofTaps;
using models::TofWaveform;

constexpr Range kPositive{.min = 0, .exclusive_min = true};
constexpr Range kNotNegative{.min = 0};
constexpr Range kShare{.min = 0, .max = 1};

void read_geometry(const ConfigNode& n, TofModel& m) {
  m.width_px = int(n.integer("width_px", {.min = 1, .max = TofModel::kMaxSize_px}));
  m.height_px = int(n.integer("height_px", {.min = 1, .max = TofModel::kMaxSize_px}));
  const ConfigNode i = n.map("intrinsics");
  m.fx_px = i.number("fx_px", kPositive);
  m.fy_px = i.number_or("fy_px", m.fx_px, kPositive);
  m.cx_px = i.number_or("cx_px", (m.width_px - 1) / 2.0);
  m.cy_px = i.number_or("cy_px", (m.height_px - 1) / 2.0);
  i.finish();
  const ConfigNode l = n.map_or_absent("lens");
  for (const auto& [key, value] : {std::pair{"k1", &m.lens.k1},
                                   {"k2", &m.lens.k2},
                                   {"p1", &m.lens.p1},
                                   {"p2", &m.lens.p2},
                                   {"k3", &m.lens.k3},
                                   {"k4", &m.lens.k4},
                                   {"k5", &m.lens.k5},
                                   {"k6", &m.lens.k6}})
    *value = l.number_or(key, *value, {.min = -1e6, .max = 1e6});
  l.finish();
}

void read_modulation(const ConfigNode& n, models::TofModulation& m) {
  if (n.has("frequencies_mhz")) {
    const std::vector<ConfigNode> list = n.list("frequencies_mhz");
    if (list.empty() || list.size() > TofModel::kMaxFrequencies)
      throw n.error("frequencies_mhz", "expected 1 to 8 frequencies, got " + std::to_string(list.size()));
    m.frequencies_hz.clear();
    for (const ConfigNode& f : list) m.frequencies_hz.push_back(f.as_number({.min = 0.1, .max = 1e4}) * 1e6);
  }
  m.contrast = n.number_or("contrast", m.contrast, {.min = 0, .max = 1, .exclusive_min = true});
  m.taps = n.choice_or("taps", {"single", "differential"}, "single") == "single" ? TofTaps::single
                                                                                 : TofTaps::differential;
  const std::string waveform = n.choice_or("waveform", {"sine", "harmonics", "triangle"}, "sine");
  m.waveform = waveform == "sine"        ? TofWaveform::sine
               : waveform == "harmonics" ? TofWaveform::harmonics
                                         : TofWaveform::triangle;
  if (m.waveform == TofWaveform::harmonics) {
    const std::vector<ConfigNode> list = n.list("harmonics");
    if (list.empty() || list.size() > m.harmonics.size())
      throw n.error("harmonics", "expected 1 to 4 relative amplitudes (of the harmonics 3, 5, 7, 9), got " +
                                     std::to_string(list.size()));
    for (std::size_t i = 0; i < list.size(); ++i) m.harmonics[i] = list[i].as_number({.min = -1, .max = 1});
  }
  m.wiggling_bias = n.flag_or("wiggling_bias", m.wiggling_bias);
  m.sine_like_noise = n.flag_or("sine_like_noise", m.sine_like_noise);
  m.integration_time_s =
      n.number_or("integration_time_ms", m.integration_time_s * 1e3, {.min = 1e-6, .max = 1e4}) * 1e-3;
  m.tap_window_s = n.number_or("tap_window_ms", m.tap_window_s * 1e3, {.min = 0, .max = 1e5}) * 1e-3;
  m.unwrap_tolerance_m = n.number_or("unwrap_tolerance_m", m.unwrap_tolerance_m, kNotNegative);
  n.finish();
}

void read_light(const ConfigNode& root, TofModel& m) {
  const ConfigNode i = root.map_or_absent("illumination");
  auto& light = m.illumination;
  light.wavelength_m =
      i.number_or("wavelength_nm", light.wavelength_m * 1e9, {.min = 300, .max = 2000}) * 1e-9;
  light.radiant_intensity_w_per_sr =
      i.number_or("radiant_intensity_w_per_sr", light.radiant_intensity_w_per_sr, kNotNegative);
  light.cosine_exponent = i.number_or("cosine_exponent", light.cosine_exponent, {.min = 0, .max = 1000});
  i.finish();
  const ConfigNode o = root.map_or_absent("optics");
  m.optics.f_number = o.number_or("f_number", m.optics.f_number, {.min = 0.5, .max = 128});
  m.optics.transmission = o.number_or("transmission", m.optics.transmission, kShare);
  m.optics.cos4_weight = o.number_or("cos4_weight", m.optics.cos4_weight, kShare);
  m.optics.filter_width_m =
      o.number_or("filter_width_nm", m.optics.filter_width_m * 1e9, {.min = 0, .max = 1000}) * 1e-9;
  o.finish();
}

void read_pixel(const ConfigNode& n, models::TofPixel& p) {
  p.pitch_m = n.number_or("pitch_um", p.pitch_m * 1e6, {.min = 0.1, .max = 1000}) * 1e-6;
  p.fill_factor = n.number_or("fill_factor", p.fill_factor, kShare);
  p.quantum_efficiency = n.number_or("quantum_efficiency", p.quantum_efficiency, kShare);
  p.full_well_e = n.number_or("full_well_e", p.full_well_e, {.min = 1, .max = 1e12});
  p.read_noise_e = n.number_or("read_noise_e", p.read_noise_e, kNotNegative);
  p.dark_current_e_per_s = n.number_or("dark_current_e_per_s", p.dark_current_e_per_s, kNotNegative);
  p.adc_bits = int(n.integer_or("adc_bits", p.adc_bits, {.min = 0, .max = 24}));
  p.ambient_suppression = n.number_or("ambient_suppression", p.ambient_suppression, kShare);
  p.trembling = n.flag_or("trembling", p.trembling);
  p.range_offset_sigma_m =
      n.number_or("range_offset_sigma_mm", p.range_offset_sigma_m * 1e3, kNotNegative) * 1e-3;
  p.gain_sigma = n.number_or("gain_sigma", p.gain_sigma, {.min = 0, .max = 0.2});
  n.finish();
}

void read_range_error(const ConfigNode& n, models::TofRangeError& e) {
  e.offset_m = n.number_or("offset_mm", e.offset_m * 1e3, {.min = -1e6, .max = 1e6}) * 1e-3;
  e.amplitude_error_m_e =
      n.number_or("amplitude_error_mm_e", e.amplitude_error_m_e * 1e3, {.min = -1e15, .max = 1e15}) * 1e-3;
  if (n.has("wiggling_spline")) {
    const ConfigNode w = n.map("wiggling_spline");
    e.wiggling.from_m = w.number("from_m", kNotNegative);
    e.wiggling.to_m = w.number("to_m", kPositive);
    const std::vector<ConfigNode> list = w.list("coefficients_mm");
    if (list.size() < 4 || list.size() > TofModel::kMaxSplineCoefficients)
      throw w.error("coefficients_mm",
                    "expected 4 to 64 coefficients of a cubic B-spline, got " + std::to_string(list.size()));
    for (const ConfigNode& c : list)
      e.wiggling.coefficients_m.push_back(c.as_number({.min = -1e6, .max = 1e6}) * 1e-3);
    w.finish();
  }
  n.finish();
}

void read_processing(const ConfigNode& root, TofModel& m) {
  const ConfigNode s = root.map_or_absent("sampling");
  m.sampling.samples =
      std::atoi(s.choice_or("samples", {"1", "4", "9", "16"}, std::to_string(m.sampling.samples)).c_str());
  m.sampling.bilinear = s.flag_or("bilinear", m.sampling.bilinear);
  m.sampling.motion = s.flag_or("motion", m.sampling.motion);
  m.sampling.multipath_rays =
      int(s.integer_or("multipath_rays", m.sampling.multipath_rays, {.min = 0, .max = 256}));
  m.sampling.sun_shadows = s.flag_or("sun_shadows", m.sampling.sun_shadows);
  m.sampling.retro_gain = s.number_or("retro_gain", m.sampling.retro_gain, kNotNegative);
  s.finish();
  const ConfigNode l = root.map_or_absent("limits");
  m.limits.min_range_m = l.number_or("min_range_m", m.limits.min_range_m, kNotNegative);
  m.limits.max_range_m = l.number_or("max_range_m", m.limits.max_range_m, kNotNegative);
  m.limits.min_amplitude_e = l.number_or("min_amplitude_e", m.limits.min_amplitude_e, kNotNegative);
  l.finish();
  const ConfigNode f = root.map_or_absent("filters");
  m.filters.flying_pixel_m = f.number_or("flying_pixel_m", m.filters.flying_pixel_m, kNotNegative);
  m.filters.median_px =
      std::atoi(f.choice_or("median_px", {"0", "3", "5"}, std::to_string(m.filters.median_px)).c_str());
  m.filters.bilateral_radius_px =
      int(f.integer_or("bilateral_radius_px", m.filters.bilateral_radius_px, {.min = 0, .max = 5}));
  m.filters.bilateral_sigma_px = f.number_or("bilateral_sigma_px", m.filters.bilateral_sigma_px, kPositive);
  m.filters.bilateral_sigma_m = f.number_or("bilateral_sigma_m", m.filters.bilateral_sigma_m, kPositive);
  f.finish();
}

}  // namespace

Result<TofModel> parse_tof_model(ConfigNode root) {
  auto model = catch_config([&] {
    TofModel m;
    read_geometry(root, m);
    read_modulation(root.map_or_absent("modulation"), m.modulation);
    read_light(root, m);
    read_pixel(root.map_or_absent("pixel"), m.pixel);
    read_range_error(root.map_or_absent("range_error"), m.range_error);
    read_processing(root, m);
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

Result<TofModel> load_tof_model(const std::filesystem::path& file, std::uint64_t draw) {
  auto root = load_sensor_model(file, draw);
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_tof_model(*root);
}

}  // namespace rigor
