// Small ways on the ellipsoid of WGS 84. Any thread, no allocation.
#pragma once

#include <cmath>

namespace rigor {

/// Metres for each radian of latitude and of longitude at a place: for ways up to some kilometres, away from
/// the poles.
struct MetresPerRadian {
  double north = 0, east = 0;
};
[[nodiscard]] inline MetresPerRadian metres_per_radian(double latitude_rad, double height_m) noexcept {
  constexpr double a_m = 6378137, flattening = 1 / 298.257223563;
  constexpr double e2 = flattening * (2 - flattening);
  const double s = std::sin(latitude_rad), w2 = 1 - e2 * s * s, w = std::sqrt(w2);
  const double meridian_m = a_m * (1 - e2) / (w2 * w), normal_m = a_m / w;
  return {meridian_m + height_m, (normal_m + height_m) * std::cos(latitude_rad)};
}

}  // namespace rigor
