#include "sensor-hal/models/camera_yaml.h"

#include <algorithm>

#include "sensor-hal/models/calibration_section.h"

namespace rigor {
namespace {

CameraModel read_model(ConfigNode n) {
  CameraModel m;
  m.width_px = static_cast<int>(n.integer("width_px", {.min = 16, .max = 16384}));
  m.height_px = static_cast<int>(n.integer("height_px", {.min = 16, .max = 16384}));
  ConfigNode i = n.map("intrinsics");
  m.fx_px = i.number("fx_px", {.min = 0, .exclusive_min = true});
  m.fy_px = i.number_or("fy_px", m.fx_px, {.min = 0, .exclusive_min = true});
  m.cx_px = i.number_or("cx_px", (m.width_px - 1) / 2.0);
  m.cy_px = i.number_or("cy_px", (m.height_px - 1) / 2.0);
  i.finish();

  m.projection = n.choice_or("projection", {"opencv", "kannala_brandt"}, "opencv") == "opencv"
                     ? Projection::opencv
                     : Projection::kannala_brandt;
  // Coefficients of the other lens would be read and then ignored.
  if (m.projection == Projection::kannala_brandt && n.has("lens"))
    throw n.error("lens", "expected `fisheye: { k1, k2, k3, k4 }` with projection: kannala_brandt, got lens");
  if (m.projection == Projection::opencv && n.has("fisheye"))
    throw n.error("fisheye", "expected `projection: kannala_brandt` with it, got the projection opencv");
  ConfigNode l = n.map_or_absent("lens");
  OpenCvLens& lens = m.lens;
  for (const auto& [key, value] : {std::pair{"k1", &lens.k1},
                                   {"k2", &lens.k2},
                                   {"p1", &lens.p1},
                                   {"p2", &lens.p2},
                                   {"k3", &lens.k3},
                                   {"k4", &lens.k4},
                                   {"k5", &lens.k5},
                                   {"k6", &lens.k6}})
    *value = l.number_or(key, *value);
  l.finish();

  ConfigNode f = n.map_or_absent("fisheye");
  for (const auto& [key, value] :
       {std::pair{"k1", &m.fisheye.k1}, {"k2", &m.fisheye.k2}, {"k3", &m.fisheye.k3}, {"k4", &m.fisheye.k4}})
    *value = f.number_or(key, *value);
  f.finish();

  const auto colours = [](ConfigNode& node, const char* key, std::array<double, 3>& values, double unit) {
    if (!node.has(key)) return;
    const std::vector<double> read = node.numbers(key, 3);
    for (std::size_t c = 0; c < 3; ++c) values[c] = read[c] * unit;
  };
  ConfigNode c = n.map_or_absent("chromatic");
  colours(c, "magnification", m.chromatic.magnification, 1.0);
  colours(c, "focus_shift_mm", m.chromatic.focus_shift_m, 1e-3);
  c.finish();

  ConfigNode d = n.map_or_absent("depth_of_field");
  m.depth_of_field.focus_distance_m = d.number_or("focus_distance_m", 0, {.min = 0});
  m.depth_of_field.focal_length_m = d.number_or("focal_length_mm", 0, {.min = 0}) * 1e-3;
  d.finish();

  ConfigNode s = n.map_or_absent("shutter");
  m.shutter.line_time_s = s.number_or("line_time_us", 0, {.min = 0, .max = 1e6}) * 1e-6;
  m.shutter.motion_blur = s.flag_or("motion_blur", m.shutter.motion_blur);
  s.finish();

  ConfigNode b = n.map_or_absent("bloom");
  m.bloom.fraction = b.number_or("fraction", m.bloom.fraction, {.min = 0, .max = 1});
  m.bloom.radius_px = b.number_or("radius_px", m.bloom.radius_px, {.min = 0.1, .max = 1000});
  m.bloom.exponent = b.number_or("exponent", m.bloom.exponent, {.min = 0.5, .max = 10});
  m.bloom.veiling_glare = b.number_or("veiling_glare", m.bloom.veiling_glare, {.min = 0, .max = 1});
  b.finish();

  ConfigNode p = n.map_or_absent("processing");
  m.processing.median_filter = p.flag_or("median_filter", m.processing.median_filter);
  colours(p, "white_balance", m.processing.white_balance, 1.0);
  m.processing.demosaic = p.flag_or("demosaic", m.processing.demosaic);
  m.processing.gamma = p.number_or("gamma", m.processing.gamma, {.min = 0.1, .max = 10});
  m.processing.subtract_black = p.flag_or("subtract_black", m.processing.subtract_black);
  p.finish();

  ConfigNode v = n.map_or_absent("vignetting");
  m.vignetting.cos4_weight = v.number_or("cos4_weight", m.vignetting.cos4_weight, {.min = 0, .max = 1});
  m.vignetting.a2 = v.number_or("a2", m.vignetting.a2);
  m.vignetting.a4 = v.number_or("a4", m.vignetting.a4);
  m.vignetting.a6 = v.number_or("a6", m.vignetting.a6);
  v.finish();

  ConfigNode o = n.map_or_absent("optics");
  m.optics.f_number = o.number_or("f_number", m.optics.f_number, {.min = 0, .exclusive_min = true});
  m.optics.transmission = o.number_or("transmission", m.optics.transmission, {.min = 0, .max = 1});
  m.optics.pixel_pitch_m =
      o.number_or("pixel_pitch_um", m.optics.pixel_pitch_m * 1e6, {.min = 0, .exclusive_min = true}) * 1e-6;
  const auto bands = [&](const char* key, std::array<double, 4>& values) {
    if (!o.has(key)) return;
    const std::vector<double> read = o.numbers(key, 4);
    std::copy(read.begin(), read.end(), values.begin());
  };
  bands("mono_efficiency", m.optics.mono_efficiency);
  bands("red_efficiency", m.optics.colour_efficiency[0]);
  bands("green_efficiency", m.optics.colour_efficiency[1]);
  bands("blue_efficiency", m.optics.colour_efficiency[2]);
  o.finish();

  ConfigNode e = n.map_or_absent("noise");
  EmvaNoise& noise = m.noise;
  noise.system_gain_dn_per_e = e.number_or("system_gain_dn_per_e", noise.system_gain_dn_per_e, {.min = 0});
  noise.black_level_dn = e.number_or("black_level_dn", noise.black_level_dn, {.min = 0});
  noise.full_well_e = e.number_or("full_well_e", noise.full_well_e, {.min = 0, .exclusive_min = true});
  noise.read_noise_e = e.number_or("read_noise_e", noise.read_noise_e, {.min = 0});
  noise.dark_current_e_per_s = e.number_or("dark_current_e_per_s", noise.dark_current_e_per_s, {.min = 0});
  noise.dsnu_e = e.number_or("dsnu_e", noise.dsnu_e, {.min = 0});
  noise.prnu = e.number_or("prnu", noise.prnu, {.min = 0, .max = 1});
  noise.shot_noise = e.flag_or("shot_noise", noise.shot_noise);
  noise.temperature_c = e.number_or("temperature_c", noise.temperature_c, {.min = -273.15, .max = 200});
  noise.dark_reference_c =
      e.number_or("dark_reference_c", noise.dark_reference_c, {.min = -273.15, .max = 200});
  noise.dark_doubling_k = e.number_or("dark_doubling_k", noise.dark_doubling_k, {.min = 1, .max = 1000});
  noise.hot_pixel_share = e.number_or("hot_pixel_share", noise.hot_pixel_share, {.min = 0, .max = 1});
  noise.hot_pixel_dark_e_per_s =
      e.number_or("hot_pixel_dark_e_per_s", noise.hot_pixel_dark_e_per_s, {.min = 0});
  noise.adc_bits = static_cast<int>(e.integer_or("adc_bits", noise.adc_bits, {.min = 8, .max = 16}));
  noise.response_c2 = e.number_or("response_c2", noise.response_c2, {.min = -1, .max = 1});
  noise.response_c3 = e.number_or("response_c3", noise.response_c3, {.min = -1, .max = 1});
  e.finish();
  return m;
}

}  // namespace

Result<CameraSensorModel> parse_camera(ConfigNode root) {
  auto sensor_model = catch_config([&] {
    CameraSensorModel s;
    s.model = read_model(root);
    s.exposure_s = root.number_or("exposure_us", s.exposure_s * 1e6, {.min = 1, .max = 1e8}) * 1e-6;
    s.supersampling = root.number_or("supersampling", s.supersampling, {.min = 1, .max = 4});
    (void)read_calibration(root);
    root.finish();
    return s;
  });
  if (!sensor_model) return sensor_model;
  if (auto valid = sensor_model->model.validate(); !valid) {
    Error e = valid.error();
    e.where = root.place() + (e.where.empty() ? "" : ": " + e.where);
    return tl::unexpected<Error>(std::move(e));
  }
  return sensor_model;
}

Result<CameraSensorModel> load_camera(const std::filesystem::path& file, std::uint64_t draw) {
  auto root = load_sensor_model(file, draw);
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_camera(*root);
}

}  // namespace rigor
