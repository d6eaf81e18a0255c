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
constexpr double kFisheyeTolerance = 1e-15;

using Lens = models::LensMath<double>;
using Noise = models::NoiseMath<double>;

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
           {"fisheye.k1", fisheye.k1, -1e6, 1e6, ""},
           {"fisheye.k2", fisheye.k2, -1e6, 1e6, ""},
           {"fisheye.k3", fisheye.k3, -1e6, 1e6, ""},
           {"fisheye.k4", fisheye.k4, -1e6, 1e6, ""},
           {"chromatic.magnification[0]", chromatic.magnification[0], 0.5, 2, ""},
           {"chromatic.magnification[1]", chromatic.magnification[1], 0.5, 2, ""},
           {"chromatic.magnification[2]", chromatic.magnification[2], 0.5, 2, ""},
           {"chromatic.focus_shift_m[0]", chromatic.focus_shift_m[0], -1e4, 1e4, "m"},
           {"chromatic.focus_shift_m[1]", chromatic.focus_shift_m[1], -1e4, 1e4, "m"},
           {"chromatic.focus_shift_m[2]", chromatic.focus_shift_m[2], -1e4, 1e4, "m"},
           {"depth_of_field.focus_distance_m", depth_of_field.focus_distance_m, 0, 1e6, "m"},
           {"depth_of_field.focal_length_m", depth_of_field.focal_length_m, 0, 10, "m"},
           {"shutter.line_time_s", shutter.line_time_s, 0, 1, "s"},
           {"bloom.fraction", bloom.fraction, 0, 1, ""},
           {"bloom.radius_px", bloom.radius_px, 0.1, 1000, "px"},
           {"bloom.exponent", bloom.exponent, 0.5, 10, ""},
           {"bloom.veiling_glare", bloom.veiling_glare, 0, 1, ""},
           {"bloom.fraction + veiling_glare", bloom.fraction + bloom.veiling_glare, 0, 1, ""},
           {"processing.white_balance[0]", processing.white_balance[0], 0, 64, ""},
           {"processing.white_balance[1]", processing.white_balance[1], 0, 64, ""},
           {"processing.white_balance[2]", processing.white_balance[2], 0, 64, ""},
           {"processing.gamma", processing.gamma, 0.1, 10, ""},
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
           {"noise.temperature_c", noise.temperature_c, -273.15, 200, "degC"},
           {"noise.dark_reference_c", noise.dark_reference_c, -273.15, 200, "degC"},
           {"noise.dark_doubling_k", noise.dark_doubling_k, 1, 1000, "K"},
           {"noise.hot_pixel_share", noise.hot_pixel_share, 0, 1, ""},
           {"noise.hot_pixel_dark_e_per_s", noise.hot_pixel_dark_e_per_s, 0, 1e9, "e-/s"},
           {"noise.response_c2", noise.response_c2, -1, 1, ""},
           {"noise.response_c3", noise.response_c3, -1, 1, ""},
           {"noise.black_level_dn", noise.black_level_dn, 0, max_dn, "DN"}}) {
    // Written so that a NaN fails too.
    if (!(b.value >= b.low && b.value <= b.high))
      return fail(ErrorCode::bad_input, "camera model",
                  std::string(b.name) + ": expected a value in [" + number(b.low) + ", " + number(b.high) +
                      "]" + (*b.unit != 0 ? std::string(" ") + b.unit : std::string()) + ", got " +
                      number(b.value));
  }
  // Least slope over 0 … 1: at the ends, or at the vertex of the parabola.
  const auto slope = [&](double s) { return 1 + s * (2 * noise.response_c2 + 3 * s * noise.response_c3); };
  const double vertex =
      noise.response_c3 != 0 ? std::clamp(-noise.response_c2 / (3 * noise.response_c3), 0.0, 1.0) : 1.0;
  if (const double least = std::min(slope(1), slope(vertex)); !(least > 0))
    return fail(ErrorCode::bad_input, "camera model",
                "noise.response_c2, response_c3: expected a response that rises over the whole range, got a "
                "slope of " +
                    number(least));
  if (projection != Projection::opencv && projection != Projection::kannala_brandt)
    return fail(
        ErrorCode::bad_input, "camera model",
        "projection: expected opencv or kannala_brandt, got " + std::to_string(static_cast<int>(projection)));
  if (projection == Projection::kannala_brandt &&
      (vignetting.a2 != 0 || vignetting.a4 != 0 || vignetting.a6 != 0))
    return fail(
        ErrorCode::bad_input, "camera model",
        "vignetting.a2, a4, a6: expected 0 with projection kannala_brandt, for tan of an angle has no end at "
        "90 degrees; got others");
  if (depth_of_field.active())
    for (int c = kRed; c <= kBlue; ++c) {
      const double in_focus = focus_distance_m(*this, c), f = focal_length_m(*this);
      if (!(in_focus > f))
        return fail(ErrorCode::bad_input, "camera model",
                    "depth_of_field.focus_distance_m with chromatic.focus_shift_m[" + std::to_string(c) +
                        "]: expected more than the focal length of " + number(f) + " m, got " +
                        number(in_focus));
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

double EmvaNoise::dark_current_at_temperature_e_per_s() const {
  return Noise::dark_current_at(dark_current_e_per_s, temperature_c, dark_reference_c, dark_doubling_k);
}
double EmvaNoise::hot_pixel_dark_at_temperature_e_per_s() const {
  return Noise::dark_current_at(hot_pixel_dark_e_per_s, temperature_c, dark_reference_c, dark_doubling_k);
}

namespace {

/// Roots of a polynomial (coefficients by rising power) in (low, high), in rising order, by bisection between
/// the roots of its derivative. Touching the axis without crossing it does not count.
int polynomial_roots(const double* coefficients, int degree, double low, double high, double* roots) {
  if (degree < 1) return 0;
  double derivative[4] = {}, turns[6];
  for (int i = 1; i <= degree; ++i) derivative[i - 1] = coefficients[i] * i;
  const int inner = polynomial_roots(derivative, degree - 1, low, high, turns + 1);
  turns[0] = low;
  turns[inner + 1] = high;
  const auto value = [&](double s) {
    double v = coefficients[degree];
    for (int i = degree - 1; i >= 0; --i) v = v * s + coefficients[i];
    return v;
  };
  int found = 0;
  for (int i = 0; i <= inner; ++i) {
    double a = turns[i], b = turns[i + 1];
    const bool up = value(a) < 0.0;
    if (up == (value(b) < 0.0)) continue;
    for (int k = 0; k < 80 && a < b; ++k) {
      const double middle = 0.5 * (a + b);
      if (middle <= a || middle >= b) break;
      ((value(middle) < 0.0) == up ? a : b) = middle;
    }
    roots[found++] = a;
  }
  return found;
}

double find_theta_max_rad(const KannalaBrandtLens& l) {
  if (l.k1 >= 0 && l.k2 >= 0 && l.k3 >= 0 && l.k4 >= 0) return std::numbers::pi;
  // dr/dθ is a polynomial in s = θ².
  const double slope[5] = {1.0, 3.0 * l.k1, 5.0 * l.k2, 7.0 * l.k3, 9.0 * l.k4};
  double roots[5];
  const int n = polynomial_roots(slope, 4, 0.0, std::numbers::pi * std::numbers::pi, roots);
  return n == 0 ? std::numbers::pi : std::sqrt(roots[0]);
}

double magnification(const CameraModel& camera, int channel) {
  return channel < 0 ? 1.0 : camera.chromatic.magnification[static_cast<std::size_t>(channel)];
}

/// Distorted coordinates of a direction.
std::optional<NormalisedPosition> distort(const CameraModel& camera, const OpticalRay& d) {
  double xd = 0, yd = 0, valid = 0;
  if (camera.projection == Projection::kannala_brandt) {
    const KannalaBrandtLens& l = camera.fisheye;
    Lens::fisheye_project(d.x, d.y, d.z, l.k1, l.k2, l.k3, l.k4, fisheye_theta_max_rad(l), xd, yd, valid);
    if (valid < 0.5) return std::nullopt;
    return NormalisedPosition{xd, yd};
  }
  if (!(d.z > 0.0)) return std::nullopt;
  const OpenCvLens& l = camera.lens;
  const double x = d.x / d.z;
  const double y = d.y / d.z;
  double x_back = 0, y_back = 0;
  Lens::lens_distort(x, y, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, xd, yd);
  // Before the fold the inverse leads back to the same ray; beyond it, to another one or to none.
  Lens::lens_undistort(xd, yd, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, kUndistortTolerance, x_back,
                       y_back, valid);
  const double scale = 1.0 + std::abs(x) + std::abs(y);
  if (valid < 0.5 || std::abs(x_back - x) > 1e-6 * scale || std::abs(y_back - y) > 1e-6 * scale)
    return std::nullopt;
  return NormalisedPosition{xd, yd};
}

/// The direction of a distorted position, not yet of unit length for the OpenCV lens: (x, y, 1).
std::optional<OpticalRay> undistort(const CameraModel& camera, double xd, double yd) {
  double x = 0, y = 0, z = 1, valid = 0;
  if (camera.projection == Projection::kannala_brandt) {
    const KannalaBrandtLens& l = camera.fisheye;
    Lens::fisheye_unproject(xd, yd, l.k1, l.k2, l.k3, l.k4, fisheye_theta_max_rad(l), kFisheyeTolerance, x, y,
                            z, valid);
  } else {
    const OpenCvLens& l = camera.lens;
    Lens::lens_undistort(xd, yd, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6, kUndistortTolerance, x, y,
                         valid);
  }
  if (valid < 0.5) return std::nullopt;
  return OpticalRay{x, y, z};
}

}  // namespace

double fisheye_theta_max_rad(const KannalaBrandtLens& l) {
  // Asked for every pixel of one camera, one after the other: the last answer is kept.
  struct Last {
    KannalaBrandtLens lens;
    double theta_rad = std::numbers::pi;
  };
  static thread_local Last last;
  if (l == last.lens) return last.theta_rad;
  const double theta_rad = find_theta_max_rad(l);
  last = {l, theta_rad};
  return theta_rad;
}
std::optional<PixelPosition> project_ray(const CameraModel& camera, const OpticalRay& direction,
                                         int channel) {
  const auto p = distort(camera, direction);
  if (!p) return std::nullopt;
  const double m = magnification(camera, channel);
  return PixelPosition{camera.fx_px * (m * p->x) + camera.cx_px, camera.fy_px * (m * p->y) + camera.cy_px};
}

std::optional<OpticalRay> unproject_ray(const CameraModel& camera, const PixelPosition& pixel, int channel) {
  const double m = magnification(camera, channel);
  auto ray = undistort(camera, (pixel.u_px - camera.cx_px) / camera.fx_px / m,
                       (pixel.v_px - camera.cy_px) / camera.fy_px / m);
  if (!ray) return std::nullopt;
  const double length = std::sqrt(ray->x * ray->x + ray->y * ray->y + ray->z * ray->z);
  return OpticalRay{ray->x / length, ray->y / length, ray->z / length};
}

std::optional<PixelPosition> project(const CameraModel& camera, const OpticalPoint& p_camera) {
  return project_ray(camera, {p_camera.x_m, p_camera.y_m, p_camera.z_m});
}

std::optional<NormalisedPosition> unproject(const CameraModel& camera, const PixelPosition& pixel) {
  const auto ray = undistort(camera, (pixel.u_px - camera.cx_px) / camera.fx_px,
                             (pixel.v_px - camera.cy_px) / camera.fy_px);
  if (!ray || !(ray->z > 0.0)) return std::nullopt;
  return NormalisedPosition{ray->x / ray->z, ray->y / ray->z};
}

double focal_length_m(const CameraModel& camera) {
  return camera.depth_of_field.focal_length_m > 0.0 ? camera.depth_of_field.focal_length_m
                                                    : camera.fx_px * camera.optics.pixel_pitch_m;
}

double aperture_diameter_m(const CameraModel& camera) {
  return focal_length_m(camera) / camera.optics.f_number;
}

double focus_distance_m(const CameraModel& camera, int channel) {
  return camera.depth_of_field.focus_distance_m +
         (channel < 0 ? 0.0 : camera.chromatic.focus_shift_m[static_cast<std::size_t>(channel)]);
}

double blur_diameter_px(const CameraModel& camera, double depth_m, int channel) {
  if (!camera.depth_of_field.active()) return 0.0;
  return Lens::blur_diameter_px(depth_m, focus_distance_m(camera, channel), focal_length_m(camera),
                                camera.optics.f_number, camera.optics.pixel_pitch_m);
}

double row_delay_s(const CameraModel& camera, double row_px) {
  return (row_px - 0.5 * (camera.height_px - 1)) * camera.shutter.line_time_s;
}

}  // namespace rigor
