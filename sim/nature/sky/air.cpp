#include "sim/nature/sky/air.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::nature {

double haze_extinction_per_m(double visibility_m, double wavelength_nm) {
  const double v_km = visibility_m * 1e-3;
  double q = 0;
  if (v_km >= 50)
    q = 1.6;
  else if (v_km >= 6)
    q = 1.3;
  else if (v_km >= 1)
    q = 0.16 * v_km + 0.34;
  else if (v_km >= 0.5)
    q = v_km - 0.5;
  return 3.91 / visibility_m * std::pow(wavelength_nm / 550, -q);
}

Spectrum haze_extinction_per_m(double visibility_m) {
  Spectrum s{};
  for (int b = 0; b < kBandCount; ++b)
    s[b] = static_cast<float>(haze_extinction_per_m(visibility_m, world::kBandWavelength_nm[b]));
  return s;
}

double rain_extinction_per_m(double rain_mm_per_h) {
  return rain_mm_per_h > 0 ? 3.65e-4 * std::pow(rain_mm_per_h, 0.63) : 0;
}

double snow_extinction_per_m(double snow_mm_per_h) {
  // N0 = 2500 R^-0.94 /(m³ mm), Lambda = 2.29 R^-0.45 /mm of molten diameter: 2·pi/4·N0·2/Lambda³ mm²/m³. A
  // flake of a tenth of the density has 10^(2/3) times the cross-section.
  return snow_mm_per_h > 0 ? 3.03e-3 * std::pow(snow_mm_per_h, 0.41) : 0;
}

double rain_fall_speed_m_per_s(double diameter_m) {
  return std::max(0.0, 9.65 - 10.3 * std::exp(-600 * diameter_m));
}

render::Precipitation precipitation(double rain_mm_per_h, double snow_mm_per_h,
                                    const Eigen::Vector3d& wind_m_per_s) {
  render::Precipitation p;
  if (!(rain_mm_per_h > 0) && !(snow_mm_per_h > 0)) return p;
  const double rain = rain_extinction_per_m(rain_mm_per_h), snow = snow_extinction_per_m(snow_mm_per_h);
  const bool snows = snow_mm_per_h > rain_mm_per_h;
  p.kind = snows ? render::Precipitation::Kind::snow : render::Precipitation::Kind::rain;
  // Median volume diameter: 3.67/Lambda (Atlas 1953); of rain Lambda = 4.1 R^-0.21 /mm.
  const double diameter_m = snows ? 1e-3 * 3.67 / 2.29 * std::pow(snow_mm_per_h, 0.45) * std::cbrt(10.0)
                                  : 1e-3 * 3.67 / 4.1 * std::pow(rain_mm_per_h, 0.21);
  const double own = snows ? snow : rain;
  p.diameter_m = static_cast<float>(diameter_m);
  p.drops_per_m3 = static_cast<float>(2 * own / (std::numbers::pi * diameter_m * diameter_m));
  const double fall = snows ? 1.0 : rain_fall_speed_m_per_s(diameter_m);
  p.velocity_m_per_s = (wind_m_per_s - Eigen::Vector3d(0, 0, fall)).cast<float>();
  p.extinction_per_m.fill(static_cast<float>(rain + snow));
  return p;
}

Eigen::Vector3d wind_velocity(double speed_m_per_s, double from_deg) {
  const double a = from_deg * std::numbers::pi / 180;
  return {-speed_m_per_s * std::sin(a), -speed_m_per_s * std::cos(a), 0};
}

}  // namespace rigor::nature
