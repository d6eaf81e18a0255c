// WGS 84 to metres east and north of an origin on the ellipsoid.
#pragma once

#include <array>
#include <cmath>
#include <numbers>

namespace rigor::forest {

struct GeodeticPlace {
  double latitude_deg = 0, longitude_deg = 0, height_m = 0;
};

[[nodiscard]] inline std::array<double, 3> earth_centred_m(const GeodeticPlace& p) noexcept {
  constexpr double a_m = 6378137.0, f = 1 / 298.257223563, e2 = f * (2 - f);
  const double lat = p.latitude_deg * std::numbers::pi / 180, lon = p.longitude_deg * std::numbers::pi / 180;
  const double n = a_m / std::sqrt(1 - e2 * std::sin(lat) * std::sin(lat));
  return {(n + p.height_m) * std::cos(lat) * std::cos(lon), (n + p.height_m) * std::cos(lat) * std::sin(lon),
          (n * (1 - e2) + p.height_m) * std::sin(lat)};
}

/// East, north [m] in the tangent plane at the origin.
[[nodiscard]] inline std::array<double, 2> east_north_m(const GeodeticPlace& origin,
                                                        const GeodeticPlace& place) noexcept {
  const auto o = earth_centred_m(origin), p = earth_centred_m(place);
  const double lat = origin.latitude_deg * std::numbers::pi / 180;
  const double lon = origin.longitude_deg * std::numbers::pi / 180;
  const double dx = p[0] - o[0], dy = p[1] - o[1], dz = p[2] - o[2];
  return {-std::sin(lon) * dx + std::cos(lon) * dy,
          -std::sin(lat) * std::cos(lon) * dx - std::sin(lat) * std::sin(lon) * dy + std::cos(lat) * dz};
}

}  // namespace rigor::forest
