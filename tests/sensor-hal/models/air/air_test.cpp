// Fog, rain and snow against published values, with the traps of their units.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "sensor-hal/models/air/air_math.h"

namespace rigor::models {
namespace {

using Air = AirMath<double>;

TEST(Fog, FollowsKimFromFiftyMetresToFiftyKilometres) {
  // alpha [1/km] = 3.91/V[km] (lambda/550)^-q worked out apart from the code, at 905 nm.
  struct Row {
    double visibility_km, q;
  };
  for (const Row& r : {Row{0.05, 0},
                       {0.2, 0},
                       {0.499, 0},
                       {0.5, 0},
                       {0.75, 0.25},
                       {1, 0.5},
                       {3, 0.82},
                       {6, 1.3},
                       {23, 1.3},
                       {49.9, 1.3},
                       {50, 1.6}}) {
    const double per_km = 3.91 / r.visibility_km * std::pow(905.0 / 550.0, -r.q);
    EXPECT_NEAR(Air::air_fog_extinction_per_m(r.visibility_km * 1000, 905) * 1000, per_km, 1e-12 * per_km)
        << r.visibility_km << " km";
  }
}

TEST(Fog, IsTwoPercentContrastAtTheVisibility) {
  // What the meteorological range means, at 550 nm: exp(-alpha V) = 0.02. Fails where km and m, or nm and µm,
  // are mixed.
  for (const double v_m : {50.0, 200.0, 1000.0, 10000.0, 50000.0})
    EXPECT_NEAR(std::exp(-Air::air_fog_extinction_per_m(v_m, 550) * v_m), 0.02, 5e-5) << v_m;
  EXPECT_NEAR(Air::air_fog_extinction_per_m(200, 905), 0.01955, 1e-12);
}

TEST(Fog, InfraredSeesFartherInHazeAndNoFartherInDenseFog) {
  EXPECT_LT(Air::air_fog_extinction_per_m(20000, 1550), 0.5 * Air::air_fog_extinction_per_m(20000, 905));
  EXPECT_DOUBLE_EQ(Air::air_fog_extinction_per_m(100, 1550), Air::air_fog_extinction_per_m(100, 905));
}

TEST(Rain, FollowsMarshallPalmer) {
  EXPECT_NEAR(Air::air_rain_extinction_per_m(10) * 1000, 1.56, 0.005);
  EXPECT_NEAR(Air::air_rain_extinction_per_m(1) * 1000, 0.365, 1e-12);
  EXPECT_EQ(Air::air_rain_extinction_per_m(0), 0);
  // From the drop sizes themselves: N(D) = 8000 exp(-4.1 R^-0.21 D) per m³ and mm, efficiency 2.
  for (const double rain : {1.0, 10.0, 50.0}) {
    const double lambda = 4.1 * std::pow(rain, -0.21);
    double area_mm2 = 0;
    const double step = 1e-3;
    for (double d = step / 2; d < 40; d += step)
      area_mm2 += 8000 * std::exp(-lambda * d) * M_PI / 4 * d * d * step;
    EXPECT_NEAR(Air::air_rain_extinction_per_m(rain), 2 * area_mm2 * 1e-6, 0.01 * 2 * area_mm2 * 1e-6)
        << rain;
  }
}

TEST(Rain, GoodinsFormulaIsItsOwnAndManyTimesThat) {
  EXPECT_NEAR(Air::air_rain_extinction_goodin_per_m(10) / Air::air_rain_extinction_per_m(10), 25.5, 0.5);
  EXPECT_EQ(Air::air_rain_extinction_goodin_per_m(0), 0);
}

TEST(Rain, DropsOfOneSizeHaveTheExtinctionOfAll) {
  for (const double rain : {0.5, 10.0}) {
    const double alpha = Air::air_rain_extinction_per_m(rain), d = Air::air_rain_diameter_m(rain);
    EXPECT_NEAR(2 * Air::air_drops_per_m3(alpha, d) * M_PI / 4 * d * d, alpha, 1e-12 * alpha);
  }
  EXPECT_NEAR(Air::air_rain_diameter_m(10), 1.45e-3, 0.01e-3);
}

TEST(Snow, TakesMoreThanTheSameWaterAsRain) {
  for (const double rate : {0.1, 1.0, 5.0})
    EXPECT_GT(Air::air_snow_extinction_per_m(rate), 4 * Air::air_rain_extinction_per_m(rate)) << rate;
  EXPECT_EQ(Air::air_snow_extinction_per_m(0), 0);
  EXPECT_GT(Air::air_snow_diameter_m(1), 2 * Air::air_rain_diameter_m(1));
}

TEST(Layer, WayBelowItsTopIsThatOfGeometry) {
  const double inf = std::numeric_limits<double>::infinity();
  struct Case {
    double z, dz, range, top, way;
  };
  for (const Case& c : {Case{2, 0, 50, 10, 50},      // level, inside
                        {20, 0, 50, 10, 0},          // level, above
                        {2, 0.5, 50, 10, 16},        // leaves
                        {20, -0.5, 50, 10, 30},      // comes in after 20 m
                        {2, 0.5, 10, 10, 10},        // ends before the top
                        {20, -0.5, 10, 10, 0},       // ends above
                        {2, -1, 50, 10, 50},         // down
                        {20, 1, 50, 10, 0},          // up
                        {10, 0.1, 50, 10, 0},        // on the top, up
                        {10, -0.1, 50, 10, 50},      // on the top, down
                        {5, 0.9, 1000, inf, 1000}})  // no top
    EXPECT_NEAR(Air::air_way_below_m(c.z, c.dz, c.range, c.top), c.way, 1e-9)
        << c.z << " " << c.dz << " " << c.range;
}

TEST(TwoWays, AreTheSquareOfOne) {
  EXPECT_NEAR(Air::air_two_way_transmission(0.5), std::exp(-0.5) * std::exp(-0.5), 1e-15);
}

TEST(AirInFloat, AgreesWithDouble) {
  // A shader's float: exp and log to a few units in the last place of an argument below 10.
  for (const double v : {50.0, 700.0, 3000.0, 30000.0, 60000.0})
    EXPECT_NEAR(AirMath<float>::air_fog_extinction_per_m(static_cast<float>(v), 905.0F),
                Air::air_fog_extinction_per_m(v, 905), 3e-6 * Air::air_fog_extinction_per_m(v, 905));
  for (const double r : {0.1, 10.0, 100.0})
    EXPECT_NEAR(AirMath<float>::air_rain_extinction_per_m(static_cast<float>(r)),
                Air::air_rain_extinction_per_m(r), 3e-6 * Air::air_rain_extinction_per_m(r));
}

}  // namespace
}  // namespace rigor::models
