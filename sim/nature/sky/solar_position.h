// Where the sun stands, by libnova.
#pragma once

#include <Eigen/Core>

namespace rigor::nature {

struct GeodeticPlace {
  double latitude_deg = 0, longitude_deg = 0;  ///< north and east positive
  double height_m = 0;                         ///< above the ellipsoid
};

struct SunPosition {
  double azimuth_deg = 180;   ///< from north over east, 0 … 360; at a pole of the meridian of the place
  double elevation_deg = 45;  ///< apparent: with refraction, which fades out below the horizon
  double distance_au = 1;
  /// World frame: x east, y north, z up; unit length.
  [[nodiscard]] Eigen::Vector3d direction() const;
};

/// Good to 0.005° between 1900 and 2100 away from the horizon (UT1 taken as UTC). `utc_s`: Unix time, may be
/// negative; beyond 1e11 s either way, the end of that range. Precondition: not NaN. The same input gives the
/// same bits, whatever was asked before. Any thread.
[[nodiscard]] SunPosition sun_position(double utc_s, const GeodeticPlace& place, double temperature_c = 15);

/// Standard atmosphere at a height [m], in hPa.
[[nodiscard]] double air_pressure_hpa(double height_m);

}  // namespace rigor::nature
