#include "sensor-hal/models/gnss/gnss_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sensor-hal/models/gnss/gnss_yaml.h"
#include "tests/sensor-hal/models/inertial/statistics.h"

namespace rigor::models {
namespace {

using test::expect_mean;
using test::expect_share;
using test::Mean;
using testing::HasSubstr;

constexpr int kSeeds = 100;
PhiloxKey key_of(int seed) { return channel_key(static_cast<std::uint64_t>(seed), 1); }

TEST(GnssModel, ErrorsAreCorrelatedOverTheTimeThatTheSensorModelSays) {
  GnssModel m;
  m.best.drift_horizontal_m = m.best.drift_vertical_m = 2;
  m.best.drift_time_s = 40;
  const double r = std::exp(-1.0 / 40);
  constexpr int kSamples = 4000;
  int within = 0, all = 0;
  double products = 0, squares = 0;
  Mean variance;
  for (int seed = 0; seed < kSeeds; ++seed) {
    GnssErrors errors(m, key_of(seed), seconds(1));
    std::array<double, 3> last = errors.at(0, 0, 0).enu_m, sum_products{}, sum_squares{};
    for (int i = 1; i < kSamples; ++i) {
      const auto e = errors.at(static_cast<std::uint64_t>(i), i, 0).enu_m;
      for (std::size_t a = 0; a < 3; ++a) {
        sum_products[a] += e[a] * last[a];
        sum_squares[a] += last[a] * last[a];
      }
      last = e;
    }
    for (std::size_t a = 0; a < 3; ++a) {
      // Of a process of first order the estimate of r has the variance (1 − r²)/n.
      const double found = sum_products[a] / sum_squares[a];
      within += std::abs(found - r) < 1.96 * std::sqrt((1 - found * found) / kSamples);
      ++all;
      products += sum_products[a], squares += sum_squares[a];
      variance.add(sum_squares[a] / (kSamples - 1));
    }
  }
  expect_share(within, all, 0.95, "intervals that hold r");
  const double pooled = products / squares, sigma = std::sqrt((1 - r * r) / kSamples / all);
  EXPECT_NEAR(pooled, r, test::kLimit * sigma);
  EXPECT_NEAR(-1 / std::log(pooled), 40, test::kLimit * 40 * 40 * sigma / r) << "s, the time constant";
  expect_mean(variance, 4, "variance");
}

TEST(GnssModel, PartsAddUpToWhatIsClaimed) {
  GnssModel m;
  m.best = {0.5, 1, 1, 2, 50};
  m.multipath_horizontal_m = 0.3;
  m.multipath_vertical_m = 0.6;
  m.canopy_multipath = 5;
  m.claimed_scale = 0.5;
  for (const double canopy : {0.0, 1.0, 0.25}) {
    Mean east, up;
    GnssError e;
    for (int seed = 0; seed < 1000; ++seed) {
      e = GnssErrors(m, key_of(seed), seconds(1)).at(1000, 1000, canopy);
      east.add(e.enu_m[0] * e.enu_m[0]);
      up.add(e.enu_m[2] * e.enu_m[2]);
    }
    const double more = 1 + 4 * canopy;
    expect_mean(east, 0.25 + 1 + std::pow(0.3 * more, 2), "variance to the east");
    expect_mean(up, 1 + 4 + std::pow(0.6 * more, 2), "variance upwards");
    EXPECT_NEAR(e.claimed_sigma_enu_m[0], 0.5 * std::sqrt(1.25 + std::pow(0.3 * more, 2)), 1e-12);
  }
}

TEST(GnssModel, EventsTakeTheirShareOfTheTimeAndLastAsLongAsTheyShould) {
  const GnssEvents events{60, 20};  // one a minute: under way 1 − e^(−1/3) of the time
  const double expected = 1 - std::exp(-20.0 / 60);
  Mean share;
  double steady_s = 0, ended = 0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    int hits = 0;
    bool before = false;
    // From a quarter of an hour on: no event began before the start.
    for (int t = 0; t < 3600; ++t) {
      const bool now = event_under_way(key_of(seed), NoiseEffect::gnss_outage, events, 1, 900 + t);
      hits += now;
      steady_s += now;
      ended += before && !now;
      before = now;
    }
    share.add(hits / 3600.0);
  }
  expect_mean(share, expected, "share of the time");
  // Busy periods of events that overlap: (e^(λ·mean) − 1)/λ in the mean. The ends of the hour cut a few.
  EXPECT_NEAR(steady_s / ended, (std::exp(1.0 / 3) - 1) * 60, 1.5);
  Mean half;
  for (int seed = 0; seed < 1000; ++seed)
    half.add(event_under_way(key_of(seed), NoiseEffect::gnss_outage, events, 0.5, 1000));
  expect_mean(half, 1 - std::exp(-0.5 * 20.0 / 60), "with half of the events");
  EXPECT_FALSE(event_under_way(key_of(1), NoiseEffect::gnss_outage, {0, 20}, 1, 5));
}

TEST(GnssModel, FallsFromFixedToFloatAndToNone) {
  GnssModel m;
  m.status = FixStatus::rtk_fixed;
  m.best = {0.01, 0.01, 0, 0, 1};
  m.rtk_float = {0.5, 0.5, 0, 0, 1};
  m.losses = {30, 20};
  m.outages = {10, 20};
  m.first_fix_s = 30;
  std::array<int, 5> seen{};
  Mean fixed, floating;
  for (int seed = 0; seed < 20; ++seed) {
    GnssErrors errors(m, key_of(seed), seconds(1));
    for (int t = 0; t < 1800; ++t) {
      const GnssError e = errors.at(static_cast<std::uint64_t>(t), t, 0);
      ++seen[static_cast<std::size_t>(e.status)];
      if (t < 30) {
        ASSERT_EQ(e.status, FixStatus::none);
      }
      if (e.status == FixStatus::none) {
        ASSERT_LT(e.satellites, 4);
      }
      if (e.status == FixStatus::rtk_fixed) fixed.add(e.enu_m[0] * e.enu_m[0]);
      if (e.status == FixStatus::rtk_float) floating.add(e.enu_m[0] * e.enu_m[0]);
    }
  }
  EXPECT_EQ(seen[1] + seen[2], 0);
  EXPECT_GT(seen[0], 20 * 30);
  expect_mean(fixed, 1e-4, "variance when fixed");
  expect_mean(floating, 0.25, "variance when float");
}

TEST(GnssModel, GivesTheSameErrorForTheSameIndex) {
  GnssModel m;
  m.best = {1, 1, 1, 1, 100};
  GnssErrors a(m, key_of(4), seconds(1)), b(m, key_of(4), seconds(1));
  for (std::uint64_t i = 0; i < 100; ++i) (void)a.at(i, 0, 0);
  EXPECT_EQ(a.at(50, 50, 0).enu_m, b.at(50, 50, 0).enu_m);
}

TEST(GnssYaml, ComplainsWithThePlace) {
  const char* const bad[][2] = {
      {"noise: {}", "status"},
      {"status: rtk_float\nnoise: {}", "rtk_fixed"},
      {"status: fix\nnoise: {}\nrtk_float: {}", "status: rtk_fixed"},
      {"status: rtk_fixed\nnoise: {}\nlosses: { per_h: 3 }", "rtk_float"},
      {"status: fix\nnoise: { white_m: 1 }", "gnss.yaml:2:"},
      {"status: fix\nnoise: {}\noutages: { per_h: 100 }\ncanopy: { events: 10 }", "540"},
      {"status: fix\nnoise: {}\ncanopy: { multipath: 0.5 }", "multipath"}};
  for (const auto& [text, what] : bad) {
    const auto m = parse_gnss_model(*ConfigDocument::parse(text, "gnss.yaml"));
    ASSERT_FALSE(m) << text;
    EXPECT_THAT(m.error().text(), HasSubstr(what)) << text;
  }
}

}  // namespace
}  // namespace rigor::models
