// The sun against published positions, and against an algorithm that shares nothing with libnova.
#include "sim/nature/sky/solar_position.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

namespace rigor::nature {
namespace {

constexpr double kRad = std::numbers::pi / 180;
constexpr double kDay = 86400;

double turn(double deg) { return std::remainder(deg, 360); }

/// Low precision formulas of the Astronomical Almanac (Michalsky 1988): 0.01° from 1950 to 2050. Without
/// refraction and parallax.
struct Almanac {
  double azimuth_deg, elevation_deg, declination_deg;
};
Almanac almanac(double utc_s, double latitude_deg, double longitude_deg) {
  const double n = utc_s / kDay + 2440587.5 - 2451545.0;
  const double mean = 280.460 + 0.9856474 * n, g = (357.528 + 0.9856003 * n) * kRad;
  const double l = (mean + 1.915 * std::sin(g) + 0.020 * std::sin(2 * g)) * kRad;
  const double e = (23.439 - 4e-7 * n) * kRad;
  const double ra = std::atan2(std::cos(e) * std::sin(l), std::cos(l));
  const double dec = std::asin(std::sin(e) * std::sin(l));
  const double sidereal = 280.46061837 + 360.98564736629 * n + longitude_deg;
  const double hour = sidereal * kRad - ra, lat = latitude_deg * kRad;
  const double el = std::asin(std::sin(dec) * std::sin(lat) + std::cos(dec) * std::cos(lat) * std::cos(hour));
  const double az =
      std::atan2(-std::sin(hour) * std::cos(dec),
                 std::sin(dec) * std::cos(lat) - std::cos(dec) * std::sin(lat) * std::cos(hour));
  return {az / kRad, el / kRad, dec / kRad};
}
double refraction_near(double elevation_deg) {
  return 1.02 / std::tan((elevation_deg + 10.3 / (elevation_deg + 5.11)) * kRad) / 60;
}

TEST(SunPosition, AgreesWithTheExampleOfNrelSpa) {
  // Reda & Andreas 2004, table A5.1: 2003-10-17 12:30:30 UTC-7, Golden, 820 hPa, 11 degC.
  const auto s = sun_position(1'066'419'030, {39.742476, -105.1786, 1830.14}, 11);
  EXPECT_NEAR(90 - s.elevation_deg, 50.11162, 0.002);
  EXPECT_NEAR(s.azimuth_deg, 194.34024, 0.002);
  EXPECT_NEAR(s.distance_au, 0.9965423, 1e-6);
}

TEST(SunPosition, StandsSouthOfParisAtMidsummerNoon) {
  const auto s = sun_position(1'718'971'200, {48.8566, 2.3522, 35});  // 2024-06-21 12:00 UTC
  EXPECT_NEAR(s.elevation_deg, 64.53, 0.03);
  EXPECT_NEAR(s.azimuth_deg, 184.0, 0.05);  // past the meridian, and so to the west
}

TEST(SunPosition, AgreesWithTheAlmanacEverywhereAndFrom1950To2050) {
  double worst = 0;
  int seen = 0;
  for (int i = 0; i < 400; ++i) {
    const double utc = -631'000'000 + i * 7'890'123.0;  // 1950 … 2050
    const double latitude = -88 + (i * 37 % 177), longitude = -180 + (i * 53 % 361);
    const auto a = almanac(utc, latitude, longitude);
    const auto s = sun_position(utc, {latitude, longitude, 0}, 10);
    if (a.elevation_deg < 8) continue;
    ++seen;
    const double elevation = a.elevation_deg + refraction_near(a.elevation_deg);
    const double apart = std::hypot(s.elevation_deg - elevation,
                                    turn(s.azimuth_deg - a.azimuth_deg) * std::cos(a.elevation_deg * kRad));
    worst = std::max(worst, apart);
  }
  EXPECT_GT(seen, 120);
  EXPECT_LT(worst, 0.02);  // the almanac's 0.01° and the difference of universal and terrestrial time
}

TEST(SunPosition, AtThePolesIsItsDeclination) {
  const double june = 1'718'917'860, december = 1'734'772'860;  // solstices of 2024
  for (const double t : {june, december}) {
    const double declination = almanac(t, 0, 0).declination_deg;
    EXPECT_NEAR(std::abs(declination), 23.44, 0.01);
    const double north = sun_position(t, {90, 0, 0}).elevation_deg;
    const double south = sun_position(t, {-90, 0, 0}).elevation_deg;
    const double bare = std::abs(declination);
    EXPECT_NEAR(declination > 0 ? north : south, bare + refraction_near(bare), 0.02);
    EXPECT_LT(declination > 0 ? south : north, -23);
  }
}

TEST(SunPosition, StandsOverheadAtTheEquatorAtEquinox) {
  double highest = 0;
  for (int minute = -30; minute <= 30; ++minute)  // 2024-03-20 is the equinox; noon at Greenwich near 12:07
    highest = std::max(highest, sun_position(1'710'936'420 + minute * 60, {0, 0, 0}).elevation_deg);
  EXPECT_GT(highest, 89.6);
  EXPECT_LE(highest, 90);
}

TEST(SunPosition, IsTheSameOnBothSidesOfTheAntimeridian) {
  for (const double t : {1'718'971'200.0, 1'718'920'000.0}) {
    const auto east = sun_position(t, {-17, 180, 0}), west = sun_position(t, {-17, -180, 0});
    EXPECT_NEAR(east.elevation_deg, west.elevation_deg, 1e-9);
    EXPECT_NEAR(turn(east.azimuth_deg - west.azimuth_deg), 0, 1e-9);
    const auto near = sun_position(t, {-17, 179.999, 0});
    EXPECT_NEAR(near.elevation_deg, east.elevation_deg, 0.002);
  }
}

TEST(SunPosition, NeverSetsNorthOfTheArcticCircleInJune) {
  double lowest = 90, at = 0;
  for (int minute = 0; minute < 1440; minute += 2) {
    const auto s = sun_position(1'718'928'000 + minute * 60.0, {69.65, 18.96, 0});  // Tromsø
    if (s.elevation_deg < lowest) lowest = s.elevation_deg, at = s.azimuth_deg;
  }
  EXPECT_NEAR(lowest, 23.43 - (90 - 69.65) + refraction_near(3.1), 0.05);
  EXPECT_NEAR(turn(at), 0, 0.6);  // due north
}

TEST(SunPosition, RisesInTheEastAndSetsInTheWest) {
  const GeodeticPlace greenwich{51.48, 0, 0};
  const auto morning = sun_position(1'710'919'800, greenwich);  // 2024-03-20 07:30 UTC
  const auto evening = sun_position(1'710'954'000, greenwich);  // 17:00
  EXPECT_NEAR(morning.azimuth_deg, 105, 5);
  EXPECT_NEAR(evening.azimuth_deg, 257, 5);
  EXPECT_GT(morning.direction().x(), 0.9);
  EXPECT_LT(evening.direction().x(), -0.9);
  EXPECT_NEAR(morning.direction().norm(), 1, 1e-12);
  EXPECT_NEAR(morning.direction().z(), std::sin(morning.elevation_deg * kRad), 1e-12);
}

TEST(SunPosition, KnowsTheYearsBefore1970) {
  const double t = -14'182'940;  // 1969-07-20 20:17:40 UTC
  const auto a = almanac(t, 28.6, -80.6);
  const auto s = sun_position(t, {28.6, -80.6, 0}, 10);
  EXPECT_NEAR(s.elevation_deg, a.elevation_deg + refraction_near(a.elevation_deg), 0.02);
  EXPECT_NEAR(turn(s.azimuth_deg - a.azimuth_deg), 0, 0.02);
}

TEST(SunPosition, RefractionLiftsTheRisingSunAndFadesWithoutAJump) {
  double last = -90;
  bool crossed = false;
  for (int second = 0; second < 3600; second += 5) {  // sunrise at Greenwich, 2024-03-20
    const double t = 1'710'912'600 + second;
    const double e = sun_position(t, {51.48, 0, 0}).elevation_deg;
    const double bare = almanac(t, 51.48, 0).elevation_deg;
    if (last > -90) {
      EXPECT_LT(std::abs(e - last), 0.03);
    }
    if (std::abs(e) < 0.02) {
      EXPECT_NEAR(e - bare, 0.55, 0.08);
      crossed = true;
    }
    if (bare < -3.1) {
      EXPECT_NEAR(e, bare, 0.02);
    }
    last = e;
  }
  EXPECT_TRUE(crossed);
}

TEST(SunPosition, DoesNotHangOnTheHistoryOfCalls) {
  const double t = 1'718'971'200;
  const GeodeticPlace p{48.8566, 2.3522, 35};
  (void)sun_position(0, p);
  const auto first = sun_position(t, p);
  for (const double before : {t - 3000, t + 8000, t - 1e9, t + 1}) {
    (void)sun_position(before, p);
    const auto again = sun_position(t, p);
    EXPECT_EQ(first.azimuth_deg, again.azimuth_deg) << before - t;
    EXPECT_EQ(first.elevation_deg, again.elevation_deg) << before - t;
  }
}

TEST(AirPressure, FallsByAnEighthInAKilometre) {
  EXPECT_NEAR(air_pressure_hpa(0), 1013.25, 1e-9);
  EXPECT_NEAR(air_pressure_hpa(1000), 898.7, 1);
  EXPECT_GT(air_pressure_hpa(1e6), 0);
}

}  // namespace
}  // namespace rigor::nature
