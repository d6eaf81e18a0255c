#include "sim/nature/sky/solar_position.h"

#include <libnova/dynamical_time.h>
#include <libnova/julian_day.h>
#include <libnova/nutation.h>
#include <libnova/sidereal_time.h>
#include <libnova/solar.h>
#include <libnova/transform.h>

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>

namespace rigor::nature {
namespace {

constexpr double kRadian = std::numbers::pi / 180;

/// Sæmundsson 1986, true elevation to refraction, both in degrees. SPA (Reda & Andreas 2004) cuts it off at
/// −0.83°; here it fades to nothing at −3° so that the sun does not jump.
double refraction_deg(double true_elevation_deg, double pressure_hpa, double temperature_c) {
  const double h = std::max(true_elevation_deg, -0.83);
  const double r = 1.02 / std::tan((h + 10.3 / (h + 5.11)) * kRadian) / 60 * (pressure_hpa / 1010) *
                   (283 / (273 + temperature_c));
  const double fade = std::clamp((true_elevation_deg + 3) / (3 - 0.83), 0.0, 1.0);
  return std::max(r, 0.0) * fade;
}

struct Ecliptic {
  double longitude_rad = 0, latitude_rad = 0;
};
/// From the ecliptic and equinox of J2000 to those of the date (Meeus, Astronomical Algorithms, 21.5
/// to 21.7).
Ecliptic precess_from_j2000(double longitude_rad, double latitude_rad, double jde) {
  const double t = (jde - 2451545.0) / 36525, second = kRadian / 3600;
  const double eta = (47.0029 * t - 0.03302 * t * t) * second;
  const double node = 174.876384 * kRadian + (-869.8089 * t + 0.03536 * t * t) * second;
  const double p = (5029.0966 * t + 1.11113 * t * t) * second;
  const double sin_b = std::sin(latitude_rad), cos_b = std::cos(latitude_rad);
  const double sin_d = std::sin(node - longitude_rad), cos_d = std::cos(node - longitude_rad);
  return {p + node - std::atan2(std::cos(eta) * cos_b * sin_d - std::sin(eta) * sin_b, cos_b * cos_d),
          std::asin(std::cos(eta) * sin_b + std::sin(eta) * cos_b * sin_d)};
}

/// Right ascension and declination of the sun as it is seen, of the date. libnova 0.16 gives the sun for the
/// equinox of J2000 without saying so, which by now is a third of a degree; its planetary theory, nutation
/// and sidereal time are good, so they are put together here.
ln_equ_posn apparent_sun(double jde, double* distance_au) {
  ln_helio_posn sun{};
  ln_get_solar_geom_coords(jde, &sun);
  ln_nutation nutation{};
  ln_get_nutation(jde, &nutation);
  auto e = precess_from_j2000(sun.L * kRadian, sun.B * kRadian, jde);
  e.longitude_rad += (nutation.longitude - 20.4898 / 3600 / sun.R) * kRadian;
  const double obliquity = (nutation.ecliptic + nutation.obliquity) * kRadian;
  *distance_au = sun.R;
  ln_equ_posn q{};
  q.ra = std::atan2(
             std::sin(e.longitude_rad) * std::cos(obliquity) - std::tan(e.latitude_rad) * std::sin(obliquity),
             std::cos(e.longitude_rad)) /
         kRadian;
  q.dec = std::asin(std::sin(e.latitude_rad) * std::cos(obliquity) +
                    std::cos(e.latitude_rad) * std::sin(obliquity) * std::sin(e.longitude_rad)) /
          kRadian;
  return q;
}

}  // namespace

Eigen::Vector3d SunPosition::direction() const {
  const double a = azimuth_deg * kRadian, e = elevation_deg * kRadian;
  return {std::sin(a) * std::cos(e), std::cos(a) * std::cos(e), std::sin(e)};
}

double air_pressure_hpa(double height_m) {
  return 1013.25 * std::pow(std::max(1 - 2.25577e-5 * height_m, 0.01), 5.25588);
}

SunPosition sun_position(double utc_s, const GeodeticPlace& place, double temperature_c) {
  // libnova keeps its last nutation in static memory and uses it again within 0.1 days: a call far away makes
  // it forget, so that the result does not hang on the history of calls.
  static std::mutex libnova;
  constexpr double kFurthest_s = 1e11;  // the planetary theory means nothing 3000 years from now
  const double jd = std::clamp(utc_s, -kFurthest_s, kFurthest_s) / 86400 + 2440587.5;
  const double jde = ln_get_jde(jd);
  SunPosition sun;
  ln_hrz_posn horizontal{};
  {
    const std::lock_guard lock(libnova);
    ln_nutation forget{};
    ln_get_nutation(jd + 1000, &forget);
    ln_equ_posn equatorial = apparent_sun(jde, &sun.distance_au);
    ln_lnlat_posn observer{};
    observer.lng = place.longitude_deg;
    observer.lat = place.latitude_deg;
    ln_get_hrz_from_equ_sidereal_time(&equatorial, &observer, ln_get_apparent_sidereal_time(jd), &horizontal);
  }
  sun.azimuth_deg = std::fmod(horizontal.az + 180, 360);  // libnova counts from the south over west
  const double parallax_deg = 8.794 / 3600 / sun.distance_au * std::cos(horizontal.alt * kRadian);
  const double elevation_deg = horizontal.alt - parallax_deg;
  sun.elevation_deg =
      elevation_deg + refraction_deg(elevation_deg, air_pressure_hpa(place.height_m), temperature_c);
  return sun;
}

}  // namespace rigor::nature
