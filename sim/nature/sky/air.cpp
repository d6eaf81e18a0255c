#include "sim/nature/sky/air.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/models/air/air_math.h"

namespace rigor::nature {

using Air = models::AirMath<double>;

double haze_extinction_per_m(double visibility_m, double wavelength_nm) {
  return Air::air_fog_extinction_per_m(visibility_m, wavelength_nm);
}

Spectrum haze_extinction_per_m(double visibility_m) {
  Spectrum s{};
  for (int b = 0; b < kBandCount; ++b)
    s[b] = static_cast<float>(haze_extinction_per_m(visibility_m, world::kBandWavelength_nm[b]));
  return s;
}

double rain_extinction_per_m(double rain_mm_per_h) { return Air::air_rain_extinction_per_m(rain_mm_per_h); }

double snow_extinction_per_m(double snow_mm_per_h) { return Air::air_snow_extinction_per_m(snow_mm_per_h); }

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
  const double diameter_m =
      snows ? Air::air_snow_diameter_m(snow_mm_per_h) : Air::air_rain_diameter_m(rain_mm_per_h);
  const double own = snows ? snow : rain;
  p.diameter_m = static_cast<float>(diameter_m);
  p.drops_per_m3 = static_cast<float>(Air::air_drops_per_m3(own, diameter_m));
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
