#include "sensor-hal/models/camera_model.h"

#include <cmath>
#include <cstdio>
#include <initializer_list>
#include <numbers>
#include <string>

#include "sensor-hal/models/one_source.h"

namespace rigor {
namespace {

constexpr double kPlanck_Js = 6.62607015e-34;
constexpr double kLightSpeed_mps = 299792458.0;
constexpr double kUndistortTolerance = 1e-13;

using Lens = models::LensMath<double>;

struct Bound {
  const char* name;
  double value;
  double low;
  double high;
  const char* unit;
};

std::string number(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", v);
  return text;
}

}  // namespace

Status CameraModel::validate() const {
  const double max_dn = std::ldexp(1.0, noise.adc_bits) - 1.0;
  for (const Bound& b : std::initializer_list<Bound>{
           {"width_px", static_cast<double>(width_px), 1, 16384, "px"},
           {"height_px", static_cast<double>(height_px), 1, 16384, "px"},
           {"fx_px", fx_px, 1e-3, 1e7, "px"},
           {"fy_px", fy_px, 1e-3, 1e7, "px"},
           {"cx_px", cx_px, -1e6, 1e6, "px"},
           {"cy_px", cy_px, -1e6, 1e6, "px"},
           {"lens.k1", lens.k1, -1e6, 1e6, ""},
           {"lens.k2", lens.k2, -1e6, 1e6, ""},
           {"lens.p1", lens.p1, -1e3, 1e3, ""},
           {"lens.p2", lens.p2, -1e3, 1e3, ""},
           {"lens.k3", lens.k3, -1e6, 1e6, ""},
           {"lens.k4", lens.k4, -1e6, 1e6, ""},
           {"lens.k5", lens.k5, -1e6, 1e6, ""},
           {"lens.k6", lens.k6, -1e6, 1e6, ""},
           {"vignetting.cos4_weight", vignetting.cos4_weight, 0, 1, ""},
           {"vignetting.a2", vignetting.a2, -1e3, 1e3, ""},
           {"vignetting.a4", vignetting.a4, -1e3, 1e3, ""},
           {"vignetting.a6", vignetting.a6, -1e3, 1e3, ""},
           {"optics.f_number", optics.f_number, 0.5, 128, ""},
           {"optics.transmission", optics.transmission, 0, 1, ""},
           {"optics.pixel_pitch_m", optics.pixel_pitch_m, 1e-7, 1e-3, "m"},
           {"noise.adc_bits", static_cast<double>(noise.adc_bits), 8, 16, "bit"},
           {"noise.system_gain_dn_per_e", noise.system_gain_dn_per_e, 0, 1e4, "DN/e-"},
           {"noise.full_well_e", noise.full_well_e, 1, 1e9, "e-"},
           {"noise.read_noise_e", noise.read_noise_e, 0, 1e6, "e-"},
           {"noise.dark_current_e_per_s", noise.dark_current_e_per_s, 0, 1e9, "e-/s"},
           {"noise.dsnu_e", noise.dsnu_e, 0, 1e6, "e-"},
           {"noise.prnu", noise.prnu, 0, 1, ""},
           {"noise.black_level_dn", noise.black_level_dn, 0, max_dn, "DN"}}) {
    // Written so that a NaN fails too.
    if (!(b.value >= b.low && b.value <= b.high))
      return fail(ErrorCode::bad_input, "camera model",
                  std::string(b.name) + ": expected a value in [" + number(b.low) + ", " + number(b.high) +
                      "]" + (*b.unit != 0 ? std::string(" ") + b.unit : std::string()) + ", got " +
                      number(b.value));
  }
  const auto check_efficiency = [](const char* name, const std::array<double, 4>& row) -> Status {
    for (const double e : row)
      if (!(e >= 0.0 && e <= 1.0))
        return fail(ErrorCode::bad_input, "camera model",
                    std::string(name) + ": expected quantum efficiencies in [0, 1], got " + number(e));
    return {};
  };
  if (auto s = check_efficiency("optics.mono_efficiency", optics.mono_efficiency); !s) return s;
  for (const auto& row : optics.colour_efficiency)
    if (auto s = check_efficiency("optics.colour_efficiency", row); !s) return s;
  return {};
}

double CameraModel::system_gain_dn_per_e() const {
  if (noise.system_gain_dn_per_e > 0.0) return noise.system_gain_dn_per_e;
  return (std::ldexp(1.0, noise.adc_bits) - 1.0 - noise.black_level_dn) / noise.full_well_e;
}

std::array<double, 4> CameraModel::electron_rate_per_radiance(const std::array<double, 4>& efficiency) const {
  // Irradiance of the sensor under a lens focused far away: E = pi/4 L tau / N^2 (EMVA 1288; Holst and
  // Lomheim).
  const double irradiance_per_radiance =
      std::numbers::pi / 4.0 * optics.transmission / (optics.f_number * optics.f_number);
  const double area_m2 = optics.pixel_pitch_m * optics.pixel_pitch_m;
  std::array<double, 4> rate{};
  for (std::size_t b = 0; b < rate.size(); ++b)
    rate[b] = irradiance_per_radiance * area_m2 * efficiency[b] * CameraOptics::kBandWavelength_m[b] /
              (kPlanck_Js * kLightSpeed_mps);
  return rate;
}

std::optional<PixelPosition> project(const CameraModel& camera, const OpticalPoint& p_camera) {
  if (!(p_camera.z_m > 0.0)) return std::nullopt;
  const OpenCvLens& l = camera.lens;
  const double x = p_camera.x_m / p_camera.z_m;
  const double y = p_camera.y_m / p_camera.z_m;
  double xd = 0, yd = 0, x_back = 0, y_back = 0, valid = 0;
  Lens::lens_distort(x, y, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, xd, yd);
  // Before the fold the inverse leads back to the same ray; beyond it, to another one or to none.
  Lens::lens_undistort(xd, yd, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, kUndistortTolerance, x_back,
                       y_back, valid);
  const double scale = 1.0 + std::abs(x) + std::abs(y);
  if (valid < 0.5 || std::abs(x_back - x) > 1e-6 * scale || std::abs(y_back - y) > 1e-6 * scale)
    return std::nullopt;
  return PixelPosition{camera.fx_px * xd + camera.cx_px, camera.fy_px * yd + camera.cy_px};
}

std::optional<NormalisedPosition> unproject(const CameraModel& camera, const PixelPosition& pixel) {
  const OpenCvLens& l = camera.lens;
  double x = 0, y = 0, valid = 0;
  Lens::lens_undistort((pixel.u_px - camera.cx_px) / camera.fx_px, (pixel.v_px - camera.cy_px) / camera.fy_px,
                       l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, kUndistortTolerance, x, y, valid);
  if (valid < 0.5) return std::nullopt;
  return NormalisedPosition{x, y};
}

}  // namespace rigor
