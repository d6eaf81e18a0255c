// Haze, fog, rain, snow and wind.
#include "sim/nature/sky/air.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rigor::nature {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(Haze, LeavesTwoPercentAtItsRangeInTheGreen) {
  for (const double v : {50.0, 200.0, 700.0, 3000.0, 20'000.0, 80'000.0})
    EXPECT_NEAR(std::exp(-haze_extinction_per_m(v, 550) * v), 0.02, 2e-4) << v;
}

TEST(Haze, FollowsKimInEachOfItsRanges) {
  struct Case {
    double visibility_m, wavelength_nm, per_km;
  };
  // 3.91/V[km]·(lambda/550)^-q, worked by hand.
  const Case cases[] = {
      {200, 1550, 19.55},                                     // below 500 m: q = 0, all bands alike
      {200, 460, 19.55},                                      //
      {800, 905, 4.8875 * std::pow(905.0 / 550, -0.3)},       // q = V − 0.5
      {3000, 850, 1.303333 * std::pow(850.0 / 550, -0.82)},   // q = 0.16·3 + 0.34
      {20'000, 905, 0.1955 * std::pow(905.0 / 550, -1.3)},    // q = 1.3
      {50'000, 1550, 0.0782 * std::pow(1550.0 / 550, -1.6)},  // q = 1.6
      {50'000, 620, 0.0782 * std::pow(620.0 / 550, -1.6)},    //
  };
  for (const auto& c : cases)
    EXPECT_NEAR(haze_extinction_per_m(c.visibility_m, c.wavelength_nm) * 1e3, c.per_km, 1e-5 * c.per_km)
        << c.visibility_m << " m, " << c.wavelength_nm << " nm";
  // In figures, so that a slip of units shows: at 20 km a 905 nm ray loses 10 % in 1 km, both ways 19 %.
  EXPECT_NEAR(std::exp(-haze_extinction_per_m(20'000, 905) * 1000), 0.9028, 0.001);
}

TEST(Haze, ReachesFurtherInTheInfrared) {
  for (const double v : {700.0, 3000.0, 20'000.0, 60'000.0}) {
    const auto s = haze_extinction_per_m(v);
    EXPECT_GT(s[2], s[1]);
    EXPECT_GT(s[1], s[0]);
    EXPECT_GT(s[0], s[3]);
    EXPECT_GT(s[3], s[4]);
    EXPECT_GT(s[4], s[5]);
  }
}

TEST(Haze, IsNothingAtInfiniteRange) {
  for (const float e : haze_extinction_per_m(kInfinity)) EXPECT_EQ(e, 0);
}

TEST(Rain, HasTheExtinctionOfMarshallAndPalmer) {
  EXPECT_EQ(rain_extinction_per_m(0), 0);
  EXPECT_NEAR(rain_extinction_per_m(10) * 1e3, 1.557, 0.001);
  EXPECT_NEAR(rain_extinction_per_m(1), 3.65e-4, 1e-12);
}

TEST(Rain, FallsAsGunnAndKinzerMeasured) {
  EXPECT_NEAR(rain_fall_speed_m_per_s(1e-3), 4.03, 0.1);
  EXPECT_NEAR(rain_fall_speed_m_per_s(2e-3), 6.49, 0.1);
  EXPECT_NEAR(rain_fall_speed_m_per_s(5e-3), 9.09, 0.1);
  EXPECT_EQ(rain_fall_speed_m_per_s(0), 0);
}

TEST(Precipitation, DrawnDropsHaveTheExtinctionOfAll) {
  for (const double rate : {0.1, 1.0, 10.0, 100.0})
    for (const bool snows : {false, true}) {
      const auto p = precipitation(snows ? 0 : rate, snows ? rate : 0, {0, 0, 0});
      EXPECT_EQ(p.kind, snows ? render::Precipitation::Kind::snow : render::Precipitation::Kind::rain);
      const double area = 3.14159265 / 4 * p.diameter_m * p.diameter_m;
      EXPECT_NEAR(2 * area * p.drops_per_m3, p.extinction_per_m[0], 1e-5 * p.extinction_per_m[0]);
      for (const float e : p.extinction_per_m) EXPECT_EQ(e, p.extinction_per_m[0]);
      EXPECT_LT(p.velocity_m_per_s.z(), 0);
    }
  const auto rain = precipitation(10, 0, {0, 0, 0});
  EXPECT_NEAR(rain.diameter_m, 1.45e-3, 0.05e-3);
  EXPECT_NEAR(rain.velocity_m_per_s.z(), -5.3, 0.2);
}

TEST(Precipitation, GoesWithTheWindAndSnowFallsAtAMetreASecond) {
  const auto wind = wind_velocity(10, 270);
  const auto p = precipitation(0, 2, wind);
  EXPECT_NEAR(p.velocity_m_per_s.x(), 10, 1e-5);
  EXPECT_NEAR(p.velocity_m_per_s.z(), -1, 1e-6);
}

TEST(Precipitation, SleetIsTheStrongerOfBothWithTheExtinctionOfBoth) {
  const auto p = precipitation(3, 1, {0, 0, 0});
  EXPECT_EQ(p.kind, render::Precipitation::Kind::rain);
  EXPECT_NEAR(p.extinction_per_m[0], rain_extinction_per_m(3) + snow_extinction_per_m(1), 1e-8);
  // Rasmussen et al. 1999: about 1 km of sight at 1 mm/h of dry snow.
  EXPECT_NEAR(3.91 / snow_extinction_per_m(1), 1300, 500);
}

TEST(Precipitation, IsNothingInDryAir) {
  const auto p = precipitation(0, 0, {5, 0, 0});
  EXPECT_EQ(p.kind, render::Precipitation::Kind::none);
  EXPECT_EQ(p.drops_per_m3, 0);
  for (const float e : p.extinction_per_m) EXPECT_EQ(e, 0);
}

TEST(Wind, ComesFromWhereItsNameSays) {
  EXPECT_TRUE(wind_velocity(3, 0).isApprox(Eigen::Vector3d(0, -3, 0)));          // north wind blows south
  EXPECT_TRUE(wind_velocity(3, 90).isApprox(Eigen::Vector3d(-3, 0, 0), 1e-12));  // east wind blows west
  EXPECT_TRUE(wind_velocity(3, 270).isApprox(Eigen::Vector3d(3, 0, 0), 1e-12));
  EXPECT_TRUE(wind_velocity(3, 225 + 720).isApprox(Eigen::Vector3d(2.12132, 2.12132, 0), 1e-5));
  EXPECT_EQ(wind_velocity(0, 123).norm(), 0);
}

}  // namespace
}  // namespace rigor::nature
