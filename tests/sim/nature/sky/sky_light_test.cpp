// Sunlight through the air and the light of the sky, clear, cloudy, hazy and at night.
#include "sim/nature/sky/sky_light.h"

#include <gtest/gtest.h>

#include <cmath>
#include <ctime>
#include <numbers>

#include "sim/nature/sky/air.h"
#include "sim/nature/sky/clouds.h"
#include "sim/nature/sky/solar_position.h"

namespace rigor::nature {
namespace {

constexpr double kRad = std::numbers::pi / 180;
constexpr int kRed = 0, kGreen = 1, kBlue = 2, k850 = 3, k905 = 4, k1550 = 5;

const ClearSky& clear_sky() {
  static const ClearSky sky(3, ground_albedo(0));
  return sky;
}
SkyState state(double elevation_deg) {
  SkyState s;
  s.sun_elevation_deg = elevation_deg;
  return s;
}
double sum(const Spectrum& s) {
  double total = 0;
  for (const float x : s) total += x;
  return total;
}
Spectrum mean_of_row(const render::SkyMap& m, int row) {
  Spectrum s{};
  for (int i = 0; i < m.width; ++i)
    for (int b = 0; b < kBandCount; ++b)
      s[b] += m.radiance[static_cast<std::size_t>(row * m.width + i)][b] / static_cast<float>(m.width);
  return s;
}
bool sound(const render::SkyMap& m) {
  for (const auto& t : m.radiance)
    for (const float x : t)
      if (!(x > 0) || !std::isfinite(x)) return false;
  return m.radiance.size() == static_cast<std::size_t>(m.width * m.height);
}
Spectrum level_total(const SkyState& s, const SkyLight& l) {
  Spectrum g = level_irradiance(*l.map);
  const auto e = sun_irradiance(s);
  for (int b = 0; b < kBandCount; ++b)
    g[b] += e[b] * static_cast<float>(std::max(std::sin(s.sun_elevation_deg * kRad), 0.0));
  return g;
}

// ---------------------------------------------------------------- the sun through clear air
TEST(AirMass, IsThatOfKastenAndYoung) {
  EXPECT_NEAR(air_mass(90), 1.0, 0.001);
  EXPECT_NEAR(air_mass(30), 1.994, 0.005);
  EXPECT_NEAR(air_mass(10), 5.59, 0.02);
  EXPECT_NEAR(air_mass(0), 37.92, 0.1);
  EXPECT_TRUE(std::isfinite(air_mass(-90)));
}

TEST(SunThroughAir, GrowsWithElevationAndIsNeverNegative) {
  Spectrum last{};
  for (double e = -5; e <= 90; e += 0.25) {
    const auto s = direct_irradiance(e, 1, {});
    for (int b = 0; b < kBandCount; ++b) {
      EXPECT_GE(s[b], last[b]) << e << " deg, band " << b;
      EXPECT_LT(s[b], kSolarIrradiance[b]);
      if (e < -0.27) {
        EXPECT_EQ(s[b], 0);
      }
    }
    last = s;
  }
}

TEST(SunThroughAir, AgreesWithTheStandardSpectrumOfAirMass1_5) {
  // ASTM G173-03 direct + circumsolar at 550, 850 and 1550 nm: 1.36, 0.88, 0.27 W/(m² nm); its aerosol (0.084
  // at 500 nm) is that of turbidity 1.74. Within 8 %: band means stand against single wavelengths.
  const auto s = direct_irradiance(41.8, 1, {.turbidity = 1.74});
  EXPECT_NEAR(s[kGreen] / kBandWidth_nm[kGreen], 1.36, 0.11);
  EXPECT_NEAR(s[k850] / kBandWidth_nm[k850], 0.88, 0.07);
  EXPECT_NEAR(s[k1550] / kBandWidth_nm[k1550], 0.27, 0.022);
}

TEST(SunThroughAir, ReddensWhenLowAndThinsWithHeight) {
  const auto high = direct_irradiance(60, 1, {}), low = direct_irradiance(4, 1, {});
  EXPECT_GT(low[kRed] / low[kBlue], 5 * high[kRed] / high[kBlue]);
  const auto peak = direct_irradiance(30, 1, {.height_m = 4000}), sea = direct_irradiance(30, 1, {});
  for (int b = 0; b < kBandCount; ++b) EXPECT_GT(peak[b], sea[b]);
  const auto hazy = direct_irradiance(30, 1, {.turbidity = 8});
  for (int b = 0; b < kBandCount; ++b) EXPECT_LT(hazy[b], sea[b]);
  const auto january = direct_irradiance(30, 0.9833, {});
  EXPECT_NEAR(january[kGreen] / sea[kGreen], 1.034, 0.002);
}

TEST(SunThroughAir, WarmAirTakes905ButNotGreen) {
  const auto cold = direct_irradiance(30, 1, {.temperature_c = -20}),
             warm = direct_irradiance(30, 1, {.temperature_c = 25});
  EXPECT_EQ(cold[kGreen], warm[kGreen]);
  EXPECT_LT(warm[k905], 0.92F * cold[k905]);
  EXPECT_NEAR(precipitable_water_cm(15), 1.75, 0.15);
}

TEST(Scattering, TableAgreesWithAirMassFormulas) {
  for (const double e : {90.0, 60.0, 30.0, 10.0, 4.0}) {
    const auto c = columns_to_space(0, std::sin(e * kRad));
    EXPECT_NEAR(c.rayleigh_m / kRayleighScaleHeight_m / air_mass(e), 1, 0.04) << e;
    EXPECT_NEAR(c.aerosol_m / kAerosolScaleHeight_m / low_air_mass(e), 1, 0.04) << e;
  }
  EXPECT_NEAR(columns_to_space(8000, 1).rayleigh_m, 8000 / std::numbers::e, 60);
  EXPECT_EQ(sun_above_ground(0, -0.01), 0);
  EXPECT_EQ(sun_above_ground(0, 0.01), 1);
  EXPECT_EQ(sun_above_ground(10'000, -0.04), 1);  // an aeroplane still sees it
}

// ---------------------------------------------------------------- the clear sky
TEST(ClearSkyLight, SumOfSunAndSkyIsThatOfClearSkyReferences) {
  // Haurwitz 1945: level broadband irradiance 1098·sin h·exp(−0.057/sin h). Of sunlight above the air 39 %
  // lie between 400 and 700 nm, of clear daylight on the ground 45 % (photosynthetically active radiation),
  // so the visible bands keep 1.15 times what the broadband keeps.
  for (const double e : {60.0, 40.0, 20.0}) {
    const double broadband = 1098 * std::exp(-0.057 / std::sin(e * kRad)) / 1361;
    const auto s = state(e);
    const auto g = level_total(s, make_sky_light(clear_sky(), s));
    double above = 0, ground = 0;
    for (const int b : {kRed, kGreen, kBlue}) {
      above += kSolarIrradiance[b] * std::sin(e * kRad);
      ground += g[b];
    }
    EXPECT_NEAR(ground / above / (1.15 * broadband), 1, 0.15) << e << " deg";
  }
}

TEST(ClearSkyLight, DiffuseShareIsPlausibleAndFallsWithWavelength) {
  const auto s = state(60);
  const auto light = make_sky_light(clear_sky(), s);
  const auto sky = level_irradiance(*light.map), all = level_total(s, light);
  EXPECT_NEAR(sky[kGreen] / all[kGreen], 0.22, 0.06);
  for (int b : {kRed, k905}) EXPECT_LT(sky[b] / all[b], sky[kGreen] / all[kGreen]);
  EXPECT_GT(sky[kBlue] / all[kBlue], sky[kGreen] / all[kGreen]);
  EXPECT_LT(sky[k1550] / all[k1550], 0.1);
}

TEST(ClearSkyLight, ZenithIsBlueHorizonIsPaleInfraredIsDark) {
  const auto light = make_sky_light(clear_sky(), state(30));
  const auto zenith = mean_of_row(*light.map, kSkyHeight - 1), horizon = mean_of_row(*light.map, 2);
  EXPECT_GT(zenith[kBlue], zenith[kGreen]);
  EXPECT_GT(zenith[kGreen], zenith[kRed]);
  EXPECT_GT(zenith[kBlue] / zenith[kRed], 1.5F);
  EXPECT_LT(horizon[kBlue] / horizon[kRed], 0.7F * zenith[kBlue] / zenith[kRed]);
  EXPECT_GT(horizon[kGreen], zenith[kGreen]);
  // Radiance per nanometre, so that the narrower bands are not judged by their width.
  for (const int b : {k850, k905, k1550})
    EXPECT_LT(zenith[b] / kBandWidth_nm[b], 0.25 * zenith[kBlue] / kBandWidth_nm[kBlue]);
}

TEST(ClearSkyLight, IsBrightestAroundTheSunAndSymmetricAboutIt) {
  auto s = state(30);
  s.sun_azimuth_deg = 180;
  const auto light = make_sky_light(clear_sky(), s);
  const auto at = [&](double azimuth_deg, double elevation_deg) {
    const double a = azimuth_deg * kRad, e = elevation_deg * kRad;
    return light.map->at({std::sin(a) * std::cos(e), std::cos(a) * std::cos(e), std::sin(e)})[kGreen];
  };
  EXPECT_GT(at(180, 30), 4 * at(0, 30));
  EXPECT_GT(at(180, 30), at(180, 50));
  EXPECT_NEAR(at(150, 30), at(210, 30), 1e-3 * at(150, 30));
  // Turning the sun turns the sky.
  s.sun_azimuth_deg = 270;
  const auto turned = make_sky_light(clear_sky(), s);
  EXPECT_NEAR(turned.map->at({-std::cos(30 * kRad), 0, std::sin(30 * kRad)})[kGreen], at(180, 30),
              1e-3 * at(180, 30));
}

TEST(ClearSkyLight, TurbidAirPalesTheSky) {
  auto s = state(45);
  const auto pure = make_sky_light(ClearSky(2, ground_albedo(0)), [&] {
    s.air.turbidity = 2;
    return s;
  }());
  const auto hazy = make_sky_light(ClearSky(8, ground_albedo(0)), [&] {
    s.air.turbidity = 8;
    return s;
  }());
  const auto a = mean_of_row(*pure.map, kSkyHeight - 1), b = mean_of_row(*hazy.map, kSkyHeight - 1);
  EXPECT_GT(a[kBlue] / a[kRed], 1.4F * b[kBlue] / b[kRed]);
}

TEST(ClearSkyLight, TwilightFallsAsItIsKnownTo) {
  // Level illuminance of the clear sky, from the three visible bands by the photopic curve's mean over each:
  // about 700, 40, 3 and 0.5 lux at 0, −4, −6 and −8° (Seidelmann 1992, table of natural illuminance).
  struct Case {
    double elevation_deg, low_lux, high_lux;
  };
  for (const auto& c : {Case{0, 350, 1200}, Case{-4, 15, 90}, Case{-6, 1.5, 9}, Case{-8, 0.2, 1.2}}) {
    const auto g = level_irradiance(*make_sky_light(clear_sky(), state(c.elevation_deg)).map);
    const double lux = 683 * (0.38 * g[kRed] + 0.75 * g[kGreen] + 0.08 * g[kBlue]);
    EXPECT_GT(lux, c.low_lux) << c.elevation_deg;
    EXPECT_LT(lux, c.high_lux) << c.elevation_deg;
  }
}

TEST(ClearSkyLight, FadesIntoNightWithoutAStepAndKeepsAFloor) {
  double last = 0;
  for (double e = 5; e >= -25; e -= 0.5) {
    const auto light = make_sky_light(clear_sky(), state(e));
    ASSERT_TRUE(sound(*light.map)) << e;
    const double g = sum(level_irradiance(*light.map));
    if (e < 5) {
      EXPECT_LE(g, last * 1.0001) << e;
      EXPECT_GT(g, last / 2.2) << e;
    }
    last = g;
  }
  const auto night = make_sky_light(clear_sky(), state(-60));
  EXPECT_GT(level_irradiance(*night.map)[kGreen], 1e-7);
  EXPECT_LT(level_irradiance(*night.map)[kGreen], 1e-5);
}

TEST(ClearSkyLight, DuskIsBrighterWhereTheSunSet) {
  auto s = state(-4);
  s.sun_azimuth_deg = 270;
  const auto light = make_sky_light(clear_sky(), s);
  const auto west = light.map->at({-1, 0, 0.05}), east = light.map->at({1, 0, 0.05});
  EXPECT_GT(west[kRed], 2 * east[kRed]);
  const auto zenith = light.map->at({0, 0, 1});
  EXPECT_GT(zenith[kBlue], zenith[kRed]);  // the blue hour
  EXPECT_GT(west[kRed] / west[kBlue], zenith[kRed] / zenith[kBlue]);
}

// ---------------------------------------------------------------- clouds
TEST(Clouds, CoverTheShareThatIsAskedFor) {
  for (const double cover : {0.0, 0.1, 0.3, 0.5, 0.8, 1.0}) {
    const CloudField field(cover);
    int cloudy = 0, all = 0;
    for (int j = 0; j < 120; ++j)
      for (int i = 0; i < 120; ++i, ++all) cloudy += field.optical_depth({i * 733.0, j * 919.0}) > 0;
    EXPECT_NEAR(static_cast<double>(cloudy) / all, cover, 0.04);
  }
}

TEST(Clouds, AreContinuousAndFarAwayStillThere) {
  const CloudField field(0.6);
  for (const double x : {0.0, -1e5, 1e7}) {
    double last = field.optical_depth({x, 77});
    for (int i = 1; i < 2000; ++i) {
      const double d = field.optical_depth({x + i * 0.5, 77});
      EXPECT_LT(std::abs(d - last), 1.0);
      last = d;
    }
  }
  EXPECT_EQ(cloud_transmittance(0), 1);
  EXPECT_LT(cloud_transmittance(40), 0.3);
}

TEST(CloudySky, OvercastHasTheStandardDistributionAndAQuarterOfTheLight) {
  auto s = state(50);
  const auto clear = level_total(s, make_sky_light(clear_sky(), s));
  s.cloud_cover = 1;
  const auto light = make_sky_light(clear_sky(), s);
  ASSERT_TRUE(sound(*light.map));
  for (const float e : sun_irradiance(s)) EXPECT_EQ(e, 0);
  const auto level = level_irradiance(*light.map);
  EXPECT_NEAR(level[kGreen] / clear[kGreen], 0.25, 0.005);
  const auto zenith = mean_of_row(*light.map, kSkyHeight - 1), horizon = mean_of_row(*light.map, 0);
  EXPECT_NEAR(zenith[kGreen] / horizon[kGreen], 3, 0.06);
  EXPECT_NEAR(zenith[kBlue] / kSolarIrradiance[kBlue] / (zenith[kRed] / kSolarIrradiance[kRed]), 1, 0.1);
}

TEST(CloudySky, LightFallsWithCoverOnTheWhole) {
  // Kasten & Czeplak 1980: 1 − 0.75·cover^3.4 in the mean over time. Here the mean over places under the
  // field.
  for (const double cover : {0.3, 0.6, 0.9, 1.0}) {
    auto s = state(50);
    const double clear = sum(level_total(s, make_sky_light(clear_sky(), s)));
    s.cloud_cover = cover;
    double mean = 0;
    constexpr int kPlaces = 12;
    for (int i = 0; i < kPlaces; ++i) {
      s.cloud_drift_m = {i * 3700.0, i * 5300.0};
      const auto light = make_sky_light(clear_sky(), s);
      ASSERT_TRUE(sound(*light.map));
      mean += sum(level_total(s, light)) / kPlaces;
    }
    EXPECT_NEAR(mean / clear, 1 - 0.75 * std::pow(cover, 3.4), 0.22) << cover;
  }
}

TEST(CloudySky, MovesWithTheWind) {
  auto s = state(50);
  s.cloud_cover = 0.5;
  const auto before = make_sky_light(clear_sky(), s);
  s.cloud_drift_m = {0, 500};
  const auto after = make_sky_light(clear_sky(), s);
  // What was at ground way y is at y + 500 m now: straight north, at the elevations that see these places.
  const auto at = [&](const SkyLight& l, double y_m) {
    return l.map->at({1e-9, y_m, kCloudBase_m})[k1550];  // clear sky is dark there, clouds stand out
  };
  double same = 0, moved = 0;
  for (int i = 0; i < 40; ++i) {
    const double y = 200 + i * 60;
    same += std::abs(at(before, y) - at(after, y));
    moved += std::abs(at(before, y) - at(after, y + 500));
  }
  EXPECT_LT(moved, 0.6 * same);
}

// ---------------------------------------------------------------- haze and fog
TEST(HazySky, ThatTurbidityAccountsForAddsNothing) {
  auto s = state(40);
  s.visibility_m = 60'000;
  for (const float d : extra_haze_depth(s)) EXPECT_EQ(d, 0);
  s.visibility_m = 4000;
  EXPECT_NEAR(extra_haze_depth(s)[kGreen], 3.91 / 4 * 1.2 - optical_depths(3).aerosol[kGreen], 1e-3);
}

TEST(HazySky, DimsTheSunAndBrightensTheSky) {
  auto s = state(40);
  const auto clear = make_sky_light(clear_sky(), s);
  const auto clear_sun = sun_irradiance(s);
  s.visibility_m = 4000;
  const auto hazy = make_sky_light(clear_sky(), s);
  EXPECT_LT(sun_irradiance(s)[kGreen], 0.5F * clear_sun[kGreen]);
  EXPECT_GT(level_irradiance(*hazy.map)[kGreen], 1.5F * level_irradiance(*clear.map)[kGreen]);
  const auto all = level_total(s, hazy), before = level_total(state(40), clear);
  EXPECT_LT(all[kGreen], before[kGreen]);
  EXPECT_GT(all[kGreen], 0.8F * before[kGreen]);
  EXPECT_NEAR(hazy.haze_radiance[kGreen], mean_of_row(*clear.map, 1)[kGreen],
              0.05F * hazy.haze_radiance[kGreen]);
}

TEST(FoggySky, KeepsTheLightOfTwoStreams) {
  auto s = state(40);
  const auto clear = level_total(s, make_sky_light(clear_sky(), s));
  s.fog_visibility_m = 100;
  s.fog_depth_m = 200;
  const auto fog = make_sky_light(clear_sky(), s);
  ASSERT_TRUE(sound(*fog.map));
  const double depth = 3.91 / 100 * 200;
  EXPECT_NEAR(level_total(s, fog)[kGreen] / clear[kGreen], 2 / (2 + 0.15 * depth), 0.01);
  EXPECT_LT(sun_irradiance(s)[kGreen], 1e-3F);
  // Inside a thick fog all directions are about as bright.
  const auto zenith = mean_of_row(*fog.map, kSkyHeight - 1)[kGreen];
  EXPECT_NEAR(fog.fog_radiance[kGreen] / zenith, 0.55, 0.1);  // half of it looks at the ground
  s.fog_depth_m = 0;                                          // above its top
  for (const float d : fog_depth(s)) EXPECT_EQ(d, 0);
}

TEST(GroundAlbedo, TurnsWhiteUnderSnow) {
  EXPECT_LT(ground_albedo(0)[kGreen], 0.2F);
  EXPECT_GT(ground_albedo(0.2)[kGreen], 0.85F);
  EXPECT_LT(ground_albedo(0.2)[k1550], 0.1F);
}

// ---------------------------------------------------------------- same in, same out
TEST(SkyLight, SameStateGivesTheSameBytes) {
  auto s = state(25);
  s.cloud_cover = 0.45;
  s.visibility_m = 8000;
  const auto a = make_sky_light(ClearSky(3, ground_albedo(0)), s), b = make_sky_light(clear_sky(), s);
  EXPECT_EQ(a.map->radiance, b.map->radiance);
  EXPECT_NE(a.map->serial, b.map->serial);
  EXPECT_EQ(a.haze_radiance, b.haze_radiance);
}

TEST(SkyLight, HardStatesAreSound) {
  for (const double e : {90.0, 0.0, -0.3, -18.99, -90.0})
    for (const double cover : {0.0, 0.5, 1.0})
      for (const double height : {-400.0, 0.0, 8000.0}) {
        auto s = state(e);
        s.cloud_cover = cover;
        s.air.height_m = height;
        s.visibility_m = 1;
        s.fog_visibility_m = 1;
        s.fog_depth_m = 1e4;
        const auto light = make_sky_light(clear_sky(), s);
        EXPECT_TRUE(sound(*light.map) || e < -0.2) << e << " " << cover << " " << height;
        for (const auto& t : light.map->radiance)
          for (const float x : t) ASSERT_TRUE(std::isfinite(x) && x >= 0) << e << " " << cover;
      }
}

}  // namespace
}  // namespace rigor::nature
