// Atmosphere, Place and StudioLight as light and air.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>

#include "sim/nature/providers.h"
#include "sim/nature/sky/air.h"
#include "sim/nature/sky/sky_light.h"
#include "sim/nature/sky/solar_position.h"
#include "sim/render/content/world_view.h"
#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::nature {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::Ge;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Le;
using world::NodeId;
using world::Numbers;
using Values = std::vector<std::pair<std::string, world::Value>>;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kJune = 1'718'971'200;  // 2024-06-21 12:00 UTC

struct AtmosphereProvider : testing::Test {
  std::unique_ptr<world::Database> db = [] {
    auto d = world::Database::create();
    EXPECT_TRUE(world::define_semantic_types(*d));
    return d;
  }();
  std::unique_ptr<render::WorldView> view;

  NodeId make(const std::string& type, const Values& values = {}) {
    auto tx = db->begin("make");
    const NodeId n = *tx.create(type);
    for (const auto& [name, value] : values) EXPECT_TRUE(tx.set(n, name, value)) << name;
    EXPECT_TRUE(tx.commit());
    return n;
  }
  void set(NodeId n, const std::string& name, const world::Value& value) {
    auto tx = db->begin("set");
    EXPECT_TRUE(tx.set(n, name, value)) << name;
    EXPECT_TRUE(tx.commit());
  }
  NodeId paris() {
    return make("Place", {{"latitude_deg", 48.8566}, {"longitude_deg", 2.3522}, {"height_m", 35.0}});
  }
  render::ContentFrame collect(double t_s = 0, double eye_z_m = 2) {
    if (!view) {
      std::vector<std::shared_ptr<render::ContentProvider>> providers;
      providers.push_back(make_atmosphere_provider());
      view = std::make_unique<render::WorldView>(*db, std::move(providers));
    }
    render::ContentQuery q;
    q.t = BenchTime(seconds_from(t_s).ns());
    q.eye = {0, 0, eye_z_m};
    return view->collect(q);
  }
};

TEST_F(AtmosphereProvider, PutsTheSunWhereDateAndPlaceSay) {
  paris();
  make("Atmosphere", {{"utc_s", kJune}});
  const auto frame = collect();
  const auto sun = sun_position(kJune, {48.8566, 2.3522, 35}, 15);
  EXPECT_TRUE(frame.light.direction_to_sun.isApprox(sun.direction(), 1e-12));
  EXPECT_NEAR(frame.light.direction_to_sun.z(), std::sin(64.54 * M_PI / 180), 1e-3);
  EXPECT_GT(frame.light.sun_irradiance[1], 100);
  ASSERT_NE(frame.light.sky, nullptr);
  EXPECT_THAT(view->warnings(), IsEmpty());
  EXPECT_THAT(frame.hazes, IsEmpty());  // infinite visibility is no haze at all
  EXPECT_EQ(frame.precipitation.kind, render::Precipitation::Kind::none);
  EXPECT_NEAR(frame.light.sun_angular_radius_rad, 0.00458, 1e-5);  // near the aphelion
}

TEST_F(AtmosphereProvider, WorldTimeRunsAtItsRate) {
  paris();
  make("Atmosphere", {{"utc_s", kJune}, {"utc_rate", 600.0}});
  const auto later = collect(12).light.direction_to_sun;
  EXPECT_TRUE(later.isApprox(sun_position(kJune + 7200, {48.8566, 2.3522, 35}, 15).direction(), 1e-3));
}

TEST_F(AtmosphereProvider, SunThatMovesStandsStillAsLongAsTheSkyDoes) {
  paris();
  make("Atmosphere", {{"utc_s", kJune}, {"utc_rate", 1.0}});
  std::set<double> places;
  for (int t = 0; t < 200; ++t) {
    const auto light = collect(t).light;
    const auto sun = sun_position(kJune + t, {48.8566, 2.3522, 35}, 15).direction();
    EXPECT_LT(std::acos(std::min(1.0, light.direction_to_sun.dot(sun))), 0.045 * M_PI / 180) << t;
    places.insert(light.direction_to_sun.x());
  }
  // One in 20 s.
  EXPECT_THAT(places.size(), AllOf(Ge(10U), Le(11U)));
}

TEST_F(AtmosphereProvider, TimeStandsStillByDefault) {
  paris();
  make("Atmosphere", {{"utc_s", kJune}});
  const auto a = collect(0), b = collect(5000);
  EXPECT_EQ(a.light.direction_to_sun, b.light.direction_to_sun);
  EXPECT_EQ(a.light.sky, b.light.sky);
}

TEST_F(AtmosphereProvider, FixedSunGoesBeforeDateAndPlace) {
  paris();
  make("Atmosphere", {{"fixed_sun", true}, {"sun_azimuth_deg", 90.0}, {"sun_elevation_deg", 0.0}});
  EXPECT_TRUE(collect().light.direction_to_sun.isApprox(Eigen::Vector3d(1, 0, 0), 1e-12));
}

TEST_F(AtmosphereProvider, SkyIsDrawnAnewOnlyWhenItHasChanged) {
  paris();
  const NodeId air = make("Atmosphere", {{"utc_s", kJune}, {"utc_rate", 1.0}});
  const auto first = collect(0).light.sky;
  EXPECT_EQ(collect(1).light.sky, first);
  EXPECT_NE(collect(60).light.sky, first);
  EXPECT_EQ(collect(0).light.sky, first);  // still kept
  set(air, "wetness", 0.5);                // does not touch the sky
  EXPECT_EQ(collect(0).light.sky, first);
  make("Tree");
  EXPECT_EQ(collect(0).light.sky, first);
  set(air, "turbidity", 6.0);
  EXPECT_NE(collect(0).light.sky, first);
}

TEST_F(AtmosphereProvider, WhatItAnswersDoesNotHangOnWhatWasAsked) {
  paris();
  make("Atmosphere", {{"utc_s", kJune},
                      {"utc_rate", 30.0},
                      {"cloud_cover", 0.4},
                      {"wind_speed_m_per_s", 7.0},
                      {"visibility_m", 9000.0}});
  for (int i = 0; i < 6; ++i) (void)collect(i * 3.7);
  const auto a = collect(40.3);
  view.reset();
  const auto b = collect(40.3);  // a new provider that was asked nothing before
  EXPECT_EQ(a.light.sky->radiance, b.light.sky->radiance);
  EXPECT_EQ(a.light.sun_irradiance, b.light.sun_irradiance);
  EXPECT_EQ(a.light.direction_to_sun, b.light.direction_to_sun);
  EXPECT_EQ(a.hazes.at(0).inscattered_radiance, b.hazes.at(0).inscattered_radiance);
}

TEST_F(AtmosphereProvider, HazeAndFogAreTheTwoOfTheirNames) {
  paris();
  const NodeId air = make("Atmosphere", {{"utc_s", kJune}, {"visibility_m", 8000.0}});
  auto frame = collect(0, 100);
  ASSERT_EQ(frame.hazes.size(), 1U);
  EXPECT_EQ(frame.hazes[0].extinction_per_m, haze_extinction_per_m(8000));
  EXPECT_EQ(frame.hazes[0].top_m, 1300);
  for (int b = 0; b < 3; ++b) {
    // As bright as the sky at the horizon.
    EXPECT_GT(frame.hazes[0].inscattered_radiance[b], 0.3F * frame.light.sky->at({1, 0, 0.02})[b]);
    EXPECT_LT(frame.hazes[0].inscattered_radiance[b], 3 * frame.light.sky->at({1, 0, 0.02})[b]);
  }
  set(air, "fog_visibility_m", 150.0);
  set(air, "fog_top_m", 40.0);
  frame = collect();
  ASSERT_EQ(frame.hazes.size(), 2U);
  EXPECT_EQ(frame.hazes[1].extinction_per_m, haze_extinction_per_m(150));
  EXPECT_EQ(frame.hazes[1].top_m, 40);
  const auto in_fog = frame.light.sun_irradiance[1];
  EXPECT_LT(in_fog, 0.5F * collect(0, 60).light.sun_irradiance[1]);  // above its top the sun shines
}

TEST_F(AtmosphereProvider, RainSnowWindAndWetness) {
  const NodeId air = make("Atmosphere", {{"fixed_sun", true},
                                         {"rain_mm_per_h", 10.0},
                                         {"wind_speed_m_per_s", 4.0},
                                         {"wind_from_deg", 270.0},
                                         {"wetness", 0.75},
                                         {"snow_depth_m", 0.3}});
  auto frame = collect();
  EXPECT_EQ(frame.precipitation.kind, render::Precipitation::Kind::rain);
  EXPECT_FLOAT_EQ(frame.precipitation.velocity_m_per_s.x(), 4);
  EXPECT_FLOAT_EQ(frame.wind.velocity_m_per_s.x(), 4);
  EXPECT_EQ(frame.surface.wetness, 0.75F);
  EXPECT_EQ(frame.surface.snow_depth_m, 0.3F);
  EXPECT_GT(frame.light.ground_albedo[0], 0.8F);
  set(air, "snow_mm_per_h", 20.0);
  EXPECT_EQ(collect().precipitation.kind, render::Precipitation::Kind::snow);
}

TEST_F(AtmosphereProvider, WithoutAnAtmosphereIsAClearNoonAndSaysSo) {
  const auto frame = collect();
  EXPECT_THAT(view->warnings(), ElementsAre(HasSubstr("no Atmosphere")));
  EXPECT_NEAR(frame.light.direction_to_sun.z(), std::sqrt(0.5), 1e-9);
  EXPECT_LT(frame.light.direction_to_sun.y(), 0);
  EXPECT_GT(frame.light.sun_irradiance[0], 50);
  EXPECT_THAT(frame.hazes, IsEmpty());
  make("Atmosphere", {{"fixed_sun", true}, {"sun_elevation_deg", 90.0}});
  EXPECT_NEAR(collect().light.direction_to_sun.z(), 1, 1e-12);
  EXPECT_THAT(view->warnings(), IsEmpty());
}

TEST_F(AtmosphereProvider, TheLowestOfSeveralCounts) {
  const NodeId first = make("Atmosphere", {{"fixed_sun", true}, {"sun_azimuth_deg", 0.0}});
  make("Atmosphere", {{"fixed_sun", true}, {"sun_azimuth_deg", 90.0}});
  EXPECT_GT(collect().light.direction_to_sun.y(), 0.5);
  EXPECT_THAT(view->warnings(), ElementsAre(HasSubstr("2 nodes of Atmosphere")));
  auto tx = db->begin("remove");
  ASSERT_TRUE(tx.remove(first));
  ASSERT_TRUE(tx.commit());
  EXPECT_GT(collect().light.direction_to_sun.x(), 0.5);
  EXPECT_THAT(view->warnings(), IsEmpty());
}

TEST_F(AtmosphereProvider, WithoutAPlaceTheSunIsThatOfTheAttributes) {
  make("Atmosphere", {{"sun_azimuth_deg", 270.0}, {"sun_elevation_deg", 30.0}});
  EXPECT_NEAR(collect().light.direction_to_sun.x(), -std::cos(M_PI / 6), 1e-12);
  EXPECT_THAT(view->warnings(), ElementsAre(HasSubstr("no Place")));
  paris();
  EXPECT_THAT(view->warnings(), IsEmpty());
}

TEST_F(AtmosphereProvider, WarnsOutsideTheWeatherSeries) {
  const NodeId air = make("Atmosphere", {{"fixed_sun", true}, {"utc_s", 50.0}});
  make("WeatherSeries", {{"columns", std::string("temperature_c")}, {"table", Numbers{0, 1, 100, 2}}});
  (void)collect();
  EXPECT_THAT(view->warnings(), IsEmpty());
  set(air, "utc_s", 101.0);
  EXPECT_THAT(view->warnings(), ElementsAre(HasSubstr("the nearest row is held")));
}

TEST_F(AtmosphereProvider, NightHasNoSunAndADarkSky) {
  paris();
  make("Atmosphere", {{"utc_s", 1'734'739'200.0}});  // 2024-12-21 00:00 UTC
  const auto frame = collect();
  EXPECT_LT(frame.light.direction_to_sun.z(), -0.8);
  for (const float e : frame.light.sun_irradiance) EXPECT_EQ(e, 0);
  for (const float l : frame.light.sky->at({0, 0, 1})) {
    EXPECT_GT(l, 0);
    EXPECT_LT(l, 1e-4F);
  }
}

TEST_F(AtmosphereProvider, AStudioLightIsTakenAsItStands) {
  make("Atmosphere", {{"visibility_m", 1000.0}, {"rain_mm_per_h", 2.0}});
  make("StudioLight", {{"direction_to_sun", world::Vector3(0, 3, 4)},
                       {"sun_irradiance_w_per_m2", Numbers{1, 2, 3, 4, 5, 6}},
                       {"zenith_radiance_w_per_m2_sr", Numbers{10, 10, 10, 10, 10, 10}},
                       {"horizon_radiance_w_per_m2_sr", Numbers{2, 2, 2, 2, 2, 2}}});
  const auto frame = collect();
  EXPECT_THAT(view->warnings(), IsEmpty());
  EXPECT_TRUE(frame.light.direction_to_sun.isApprox(Eigen::Vector3d(0, 0.6, 0.8), 1e-12));
  EXPECT_EQ(frame.light.sun_irradiance, (Spectrum{1, 2, 3, 4, 5, 6}));
  EXPECT_NEAR(frame.light.sky->at({0, 0, 1})[0], 10, 0.01);
  EXPECT_NEAR(frame.light.sky->at({std::sqrt(0.75), 0, 0.5})[2], 6, 0.01);
  EXPECT_NEAR(frame.light.sky->at({1, 0, 0})[5], 2, 0.06);
  EXPECT_EQ(frame.hazes.size(), 1U);
  EXPECT_EQ(frame.precipitation.kind, render::Precipitation::Kind::rain);
}

TEST_F(AtmosphereProvider, NumbersThatAreNotFiniteAreSaidAndReplaced) {
  paris();
  make("Atmosphere", {{"utc_s", kInfinity},
                      {"wind_from_deg", -kInfinity},
                      {"fog_top_m", -kInfinity},
                      {"fog_visibility_m", 100.0}});
  const auto frame = collect();
  EXPECT_THAT(view->warnings(), ElementsAre(HasSubstr("utc_s"), HasSubstr("wind_from_deg")));
  EXPECT_TRUE(frame.light.direction_to_sun.isApprox(
      sun_position(kJune, {48.8566, 2.3522, 35}, 15).direction(), 1e-12));
  EXPECT_GT(frame.light.sun_irradiance[1], 100);  // above a fog that is nowhere
}

TEST_F(AtmosphereProvider, AnyDateIsSound) {
  paris();
  const NodeId air = make("Atmosphere");
  for (const double t : {-1e300, -1e13, -1e10, 0.0, 1e10, 1e13, 1e300}) {
    set(air, "utc_s", t);
    const auto frame = collect();
    EXPECT_NEAR(frame.light.direction_to_sun.norm(), 1, 1e-9) << t;
    for (const float x : frame.light.sky->radiance.front()) EXPECT_TRUE(std::isfinite(x) && x > 0) << t;
  }
}

TEST_F(AtmosphereProvider, HardQueriesAreSound) {
  paris();
  make("Atmosphere", {{"utc_s", kJune}, {"fog_visibility_m", 1.0}, {"cloud_cover", 0.5}});
  for (const double z : {-1e4, 1e6, kInfinity, std::nan("")}) {
    const auto frame = collect(1e6, z);
    for (const auto& t : frame.light.sky->radiance)
      for (const float x : t) ASSERT_TRUE(std::isfinite(x) && x >= 0) << z;
  }
  EXPECT_TRUE(std::isfinite(collect(-1e6).light.sun_irradiance[0]));
}

}  // namespace
}  // namespace rigor::nature
