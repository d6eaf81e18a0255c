// Weather over time, written into the Atmosphere by a rule.
#include "sim/nature/sky/weather.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "sim/world/semantic_types.h"

namespace rigor::nature {
namespace {

using testing::HasSubstr;
using world::Numbers;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Weather : testing::Test {
  std::unique_ptr<world::Database> db = [] {
    auto d = world::Database::create();
    EXPECT_TRUE(world::define_semantic_types(*d));
    return d;
  }();
  world::types::Atmosphere a{db->schema()};
  world::types::WeatherSeries w{db->schema()};
  world::NodeId air, series;

  Status make(const std::string& columns, const Numbers& table) {
    auto tx = db->begin("weather");
    air = *tx.create(a.type);
    series = *tx.create(w.type);
    EXPECT_TRUE(tx.set(air, a.utc_s, 1000.0));
    EXPECT_TRUE(tx.set(series, w.columns, columns));
    EXPECT_TRUE(tx.set(series, w.table, table));
    return tx.commit();
  }
  void go_to(double utc_s) {
    auto tx = db->begin("time");
    EXPECT_TRUE(tx.set(air, a.utc_s, utc_s));
    const auto s = tx.commit();
    EXPECT_TRUE(s) << s.error().text();
  }
  double get(world::Attribute<double> x) { return *db->snapshot().get(air, x); }
};

TEST_F(Weather, FollowsTheClock) {
  ASSERT_TRUE(add_weather_rule(*db));
  ASSERT_TRUE(make("temperature_c rain_mm_per_h", {1000, 10, 0, 2000, 20, 5, 4000, -20, 0}));
  EXPECT_EQ(get(a.temperature_c), 10);  // with the series, in its own transaction
  go_to(1500);
  EXPECT_DOUBLE_EQ(get(a.temperature_c), 15);
  EXPECT_DOUBLE_EQ(get(a.rain_mm_per_h), 2.5);
  go_to(3000);
  EXPECT_DOUBLE_EQ(get(a.temperature_c), 0);
  go_to(2000);
  EXPECT_EQ(get(a.rain_mm_per_h), 5);
}

TEST_F(Weather, HoldsItsEnds) {
  ASSERT_TRUE(add_weather_rule(*db));
  ASSERT_TRUE(make("temperature_c", {1000, 10, 2000, 20}));
  go_to(-1e9);
  EXPECT_EQ(get(a.temperature_c), 10);
  go_to(1e12);
  EXPECT_EQ(get(a.temperature_c), 20);
}

TEST_F(Weather, AChangedSeriesCountsAtOnce) {
  ASSERT_TRUE(add_weather_rule(*db));
  ASSERT_TRUE(make("temperature_c", {1000, 10}));
  auto tx = db->begin("correct");
  ASSERT_TRUE(tx.set(series, w.table, Numbers{1000, 12.5}));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(get(a.temperature_c), 12.5);
  EXPECT_TRUE(db->undo());
  EXPECT_EQ(get(a.temperature_c), 10);  // one step of undo takes back both
}

TEST_F(Weather, WindTurnsTheShortWay) {
  ASSERT_TRUE(make("wind_from_deg", {0, 350, 100, 30, 200, 200}));
  const auto t = *WeatherTable::of(db->snapshot(), series);
  EXPECT_NEAR(t.at(0, 25), 0, 1e-9);
  EXPECT_NEAR(t.at(0, 50), 10, 1e-9);
  EXPECT_NEAR(t.at(0, 150), 115, 1e-9);
  EXPECT_EQ(t.at(0, 0), 350);
}

TEST_F(Weather, SightIsLinearInItsExtinctionAndKnowsInfinity) {
  ASSERT_TRUE(make("visibility_m fog_top_m", {0, 1000, 50, 100, kInfinity, kInfinity, 200, kInfinity, 80}));
  const auto t = *WeatherTable::of(db->snapshot(), series);
  EXPECT_DOUBLE_EQ(t.at(0, 50), 2000);
  EXPECT_EQ(t.at(0, 100), kInfinity);
  EXPECT_EQ(t.at(0, 150), kInfinity);
  EXPECT_EQ(t.at(1, 50), 50);
  EXPECT_EQ(t.at(1, 150), kInfinity);
  EXPECT_EQ(t.at(1, 200), 80);
  EXPECT_TRUE(t.covers(0) && t.covers(200));
  EXPECT_FALSE(t.covers(-1) || t.covers(201) || t.covers(std::nan("")));
}

TEST_F(Weather, LaterSeriesGoBeforeEarlierOnes) {
  ASSERT_TRUE(add_weather_rule(*db));
  ASSERT_TRUE(make("temperature_c cloud_cover", {1000, 10, 0.5}));
  auto tx = db->begin("more");
  const auto second = *tx.create(w.type);
  ASSERT_TRUE(tx.set(second, w.columns, std::string("temperature_c")));
  ASSERT_TRUE(tx.set(second, w.table, Numbers{1000, -3}));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(get(a.temperature_c), -3);
  EXPECT_EQ(get(a.cloud_cover), 0.5);
}

TEST_F(Weather, RefusesWhatIsNoTable) {
  ASSERT_TRUE(add_weather_rule(*db));
  const auto refused = [&](const std::string& columns, const Numbers& table) {
    const auto before = db->snapshot().node_count();
    const auto s = make(columns, table);
    EXPECT_EQ(db->snapshot().node_count(), before);
    return s ? std::string() : s.error().text();
  };
  EXPECT_THAT(refused("temprature_c", {0, 1}), HasSubstr("temprature_c"));
  EXPECT_THAT(refused("utc_s", {0, 1}), HasSubstr("utc_s"));
  EXPECT_THAT(refused("fixed_sun", {0, 1}), HasSubstr("fixed_sun"));
  EXPECT_THAT(refused("name", {0, 1}), HasSubstr("name"));
  EXPECT_THAT(refused("temperature_c temperature_c", {0, 1, 2}), HasSubstr("twice"));
  EXPECT_THAT(refused("temperature_c", {0, 1, 2}), HasSubstr("3 numbers"));
  EXPECT_THAT(refused("", {0, 1}), HasSubstr("2 numbers"));
  EXPECT_THAT(refused("temperature_c", {5, 1, 5, 2}), HasSubstr("row 1"));
  EXPECT_THAT(refused("temperature_c", {kInfinity, 1}), HasSubstr("row 0"));
  EXPECT_THAT(refused("cloud_cover", {1000, 1.5}), HasSubstr("cloud_cover"));  // the Atmosphere's own limits
}

TEST_F(Weather, NothingToSayChangesNothing) {
  ASSERT_TRUE(add_weather_rule(*db));
  ASSERT_TRUE(make("", {}));
  go_to(5);
  EXPECT_EQ(get(a.temperature_c), 15);
  auto tx = db->begin("series alone");
  ASSERT_TRUE(tx.remove(air));
  ASSERT_TRUE(tx.set(series, w.columns, std::string("temperature_c")));
  ASSERT_TRUE(tx.set(series, w.table, Numbers{0, 1}));
  EXPECT_TRUE(tx.commit());
}

TEST_F(Weather, RulesAreAddedOnce) {
  ASSERT_TRUE(add_weather_rule(*db));
  EXPECT_FALSE(add_weather_rule(*db));
  const auto bare = world::Database::create();
  EXPECT_FALSE(add_weather_rule(*bare));
}

}  // namespace
}  // namespace rigor::nature
