#include "sensor-hal/models/tof/tof_model.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <numeric>
#include <string>

#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::models {
namespace {

constexpr double kPlanck_Js = 6.62607015e-34;
constexpr double kLightSpeed_mps = 299792458.0;
/// Candidates that the unwrapping may have to look at for each pixel.
constexpr double kMaxWraps = 1024;

struct Bound {
  const char* name;
  double value, low, high;
  const char* unit;
};

std::string number(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", v);
  return text;
}

tl::unexpected<Error> refuse(const char* name, const std::string& expected, const std::string& got) {
  return fail(ErrorCode::bad_input, "time-of-flight model",
              std::string(name) + ": expected " + expected + ", got " + got);
}

std::int64_t common_divisor_hz(const std::vector<double>& frequencies) {
  std::int64_t g = 0;
  for (const double f : frequencies) g = std::gcd(g, std::llround(f));
  return g;
}

}  // namespace

Status TofModel::validate() const {
  const TofModulation& m = modulation;
  const TofPixel& p = pixel;
  if (m.frequencies_hz.empty() || m.frequencies_hz.size() > kMaxFrequencies)
    return refuse("modulation.frequencies_hz", "1 to 8 frequencies", std::to_string(m.frequencies_hz.size()));
  for (const double f : m.frequencies_hz)
    if (!(f >= 1e5 && f <= 1e10))
      return refuse("modulation.frequencies_hz", "values in [1e+05, 1e+10] Hz", number(f));
  for (std::size_t i = 0; i < m.frequencies_hz.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (m.frequencies_hz[i] == m.frequencies_hz[j])
        return refuse("modulation.frequencies_hz", "frequencies that differ",
                      number(m.frequencies_hz[i]) + " twice");
  for (const Bound& b : std::initializer_list<Bound>{
           {"width_px", double(width_px), 1, kMaxSize_px, "px"},
           {"height_px", double(height_px), 1, kMaxSize_px, "px"},
           {"fx_px", fx_px, 1e-3, 1e7, "px"},
           {"fy_px", fy_px, 1e-3, 1e7, "px"},
           {"cx_px", cx_px, -1e6, 1e6, "px"},
           {"cy_px", cy_px, -1e6, 1e6, "px"},
           {"modulation.contrast", m.contrast, 1e-6, 1, ""},
           {"modulation.integration_time_s", m.integration_time_s, 1e-9, 10, "s"},
           {"modulation.tap_window_s", m.tap_window_s, 0, 100, "s"},
           {"modulation.unwrap_tolerance_m", m.unwrap_tolerance_m, 0, 1e6, "m"},
           {"illumination.wavelength_m", illumination.wavelength_m, 300e-9, 2000e-9, "m"},
           {"illumination.radiant_intensity_w_per_sr", illumination.radiant_intensity_w_per_sr, 0, 1e9,
            "W/sr"},
           {"illumination.cosine_exponent", illumination.cosine_exponent, 0, 1000, ""},
           {"optics.f_number", optics.f_number, 0.5, 128, ""},
           {"optics.transmission", optics.transmission, 0, 1, ""},
           {"optics.cos4_weight", optics.cos4_weight, 0, 1, ""},
           {"optics.filter_width_m", optics.filter_width_m, 0, 1000e-9, "m"},
           {"pixel.pitch_m", p.pitch_m, 1e-7, 1e-3, "m"},
           {"pixel.fill_factor", p.fill_factor, 0, 1, ""},
           {"pixel.quantum_efficiency", p.quantum_efficiency, 0, 1, ""},
           {"pixel.full_well_e", p.full_well_e, 1, 1e12, "e-"},
           {"pixel.read_noise_e", p.read_noise_e, 0, 1e6, "e-"},
           {"pixel.dark_current_e_per_s", p.dark_current_e_per_s, 0, 1e12, "e-/s"},
           {"pixel.adc_bits", double(p.adc_bits), 0, 24, "bit"},
           {"pixel.ambient_suppression", p.ambient_suppression, 0, 1, ""},
           {"pixel.range_offset_sigma_m", p.range_offset_sigma_m, 0, 1e3, "m"},
           {"pixel.gain_sigma", p.gain_sigma, 0, 0.2, ""},
           {"range_error.offset_m", range_error.offset_m, -1e3, 1e3, "m"},
           {"range_error.amplitude_error_m_e", range_error.amplitude_error_m_e, -1e12, 1e12, "m e-"},
           {"sampling.multipath_rays", double(sampling.multipath_rays), 0, 256, ""},
           {"sampling.retro_gain", sampling.retro_gain, 0, 1e6, ""},
           {"limits.min_range_m", limits.min_range_m, 0, 1e6, "m"},
           {"limits.max_range_m", limits.max_range_m, 0, 1e6, "m"},
           {"limits.min_amplitude_e", limits.min_amplitude_e, 0, 1e12, "e-"},
           {"filters.flying_pixel_m", filters.flying_pixel_m, 0, 1e6, "m"},
           {"filters.bilateral_radius_px", double(filters.bilateral_radius_px), 0, 5, "px"},
           {"filters.bilateral_sigma_px", filters.bilateral_sigma_px, 1e-3, 1e3, "px"},
           {"filters.bilateral_sigma_m", filters.bilateral_sigma_m, 1e-6, 1e6, "m"}}) {
    // Written so that a NaN fails too.
    if (!(b.value >= b.low && b.value <= b.high))
      return refuse(b.name,
                    "a value in [" + number(b.low) + ", " + number(b.high) + "]" +
                        (*b.unit != 0 ? std::string(" ") + b.unit : std::string()),
                    number(b.value));
  }
  for (const auto& [name, value] :
       std::initializer_list<std::pair<const char*, double>>{{"lens.k1", lens.k1},
                                                             {"lens.k2", lens.k2},
                                                             {"lens.p1", lens.p1},
                                                             {"lens.p2", lens.p2},
                                                             {"lens.k3", lens.k3},
                                                             {"lens.k4", lens.k4},
                                                             {"lens.k5", lens.k5},
                                                             {"lens.k6", lens.k6}})
    if (!(std::abs(value) <= 1e6)) return refuse(name, "a value in [-1e+06, 1e+06]", number(value));
  for (const int n : {1, 4, 9, 16, 0}) {
    if (n == 0) return refuse("sampling.samples", "1, 4, 9 or 16", std::to_string(sampling.samples));
    if (n == sampling.samples) break;
  }
  if (const auto& w = range_error.wiggling; !w.coefficients_m.empty()) {
    if (w.coefficients_m.size() < 4 || w.coefficients_m.size() > kMaxSplineCoefficients)
      return refuse("range_error.wiggling_spline", "4 to 64 coefficients",
                    std::to_string(w.coefficients_m.size()));
    if (!(w.from_m >= 0 && w.to_m > w.from_m && w.to_m <= 1e5))
      return refuse("range_error.wiggling_spline", "0 <= from_m < to_m <= 1e+05 m",
                    number(w.from_m) + " to " + number(w.to_m));
    for (const double c : w.coefficients_m)
      if (!(std::abs(c) <= 1e3))
        return refuse("range_error.wiggling_spline", "coefficients in [-1000, 1000] m", number(c));
  }
  const double rays = double(width_px) * height_px * std::max(sampling.samples, sampling.multipath_rays);
  if (rays > kMaxRays)
    return refuse(
        "sampling",
        "at most " + number(kMaxRays) + " rays in a frame (pixels times samples, or multipath_rays)",
        number(rays));
  if (filters.median_px != 0 && filters.median_px != 3 && filters.median_px != 5)
    return refuse("filters.median_px", "0, 3 or 5", std::to_string(filters.median_px));
  if (limits.max_range_m > 0 && !(limits.max_range_m > limits.min_range_m))
    return refuse("limits.max_range_m", "more than limits.min_range_m (0: no limit)",
                  number(limits.max_range_m));
  // A tap collects no negative light: the correlation stays within ±1.
  double peak = m.contrast;
  if (m.waveform == TofWaveform::harmonics)
    for (const double a : m.harmonics) peak += m.contrast * std::abs(a);
  if (m.waveform == TofWaveform::triangle) peak *= std::numbers::pi * std::numbers::pi / 8;
  if (!(peak <= 1 + 1e-9))
    return refuse("modulation.contrast",
                  "a contrast that with its harmonics stays within 1 (taps cannot be negative)",
                  number(peak));
  if (m.frequencies_hz.size() > 1) {
    const double highest = *std::max_element(m.frequencies_hz.begin(), m.frequencies_hz.end());
    const double wraps = highest / double(common_divisor_hz(m.frequencies_hz));
    if (!(wraps <= kMaxWraps))
      return refuse("modulation.frequencies_hz",
                    "a greatest common divisor (in Hz) of at least a 1024th of the highest frequency",
                    "a highest frequency of " + number(wraps) + " times it");
  }
  return {};
}

double TofModel::unambiguous_range_m() const {
  const auto& f = modulation.frequencies_hz;
  return kLightSpeed_mps / (2 * (f.size() == 1 ? f[0] : double(common_divisor_hz(f))));
}

double TofModel::electrons_per_radiance() const {
  return std::numbers::pi / 4 * optics.transmission / (optics.f_number * optics.f_number) * pixel.pitch_m *
         pixel.pitch_m * pixel.fill_factor * pixel.quantum_efficiency * illumination.wavelength_m /
         (kPlanck_Js * kLightSpeed_mps) * modulation.integration_time_s;
}

double TofModel::active_electrons(double range_m, double reflectance) const {
  return TofMath<double>::tof_active_electrons(electrons_per_radiance(),
                                               illumination.radiant_intensity_w_per_sr, range_m, reflectance);
}

int TofModel::exposures() const {
  return int(modulation.frequencies_hz.size()) * (modulation.taps == TofTaps::single ? 4 : 2);
}

double TofModel::effective_tap_window_s() const {
  return modulation.tap_window_s > 0 ? modulation.tap_window_s : modulation.integration_time_s * exposures();
}

double TofModel::exposure_offset_s(int exposure) const {
  const double n = exposures();
  return (exposure - (n - 1) / 2) * effective_tap_window_s() / n;
}

CameraModel TofModel::camera() const {
  CameraModel c;
  c.width_px = width_px;
  c.height_px = height_px;
  c.fx_px = fx_px;
  c.fy_px = fy_px;
  c.cx_px = cx_px;
  c.cy_px = cy_px;
  c.lens = lens;
  return c;
}

}  // namespace rigor::models
