#include "sensor-hal/models/imu/imu_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "sensor-hal/models/imu/imu_yaml.h"
#include "tests/sensor-hal/models/inertial/statistics.h"

namespace rigor::models {
namespace {

using testing::HasSubstr;
using Vector = std::array<double, 3>;

const Duration kPeriod = milliseconds(5);
PhiloxKey key_of(int seed) { return channel_key(static_cast<std::uint64_t>(seed), 1); }

ImuModel noisy() {
  ImuModel m;
  for (ImuTriad* t : {&m.accelerometer, &m.gyroscope}) {
    t->bias_sigma = 0.1;
    t->white = {1e-3, 1e-3, 1e-3};
    t->instability = 1e-3;
    t->random_walk = 1e-3;
    t->bandwidth_hz = 40;
  }
  return m;
}

TEST(ImuModel, IsTransparentWithoutErrors) {
  ImuErrors none(ImuModel{}, key_of(1), kPeriod);
  const ImuSample s = none.measure(17, 3, {1, -2, 9.81}, {0.1, 0.2, -0.3});
  EXPECT_EQ(s.specific_force_mps2, (Vector{1, -2, 9.81}));
  EXPECT_EQ(s.angular_rate_radps, (Vector{0.1, 0.2, -0.3}));
  EXPECT_TRUE(std::isnan(s.temperature_c));
}

TEST(ImuModel, MixesAxesAsTheSensorModelSays) {
  ImuTriad t;
  t.bias = {1, 2, 3};
  t.bias_per_k = {0.1, 0, 0};
  t.scale = {0.5, 0, 0};
  t.misalignment = {0.01, 0.02, 0.03, 0.04, 0.05, 0.06};
  t.g_sensitivity = {0, 0, 0.1, 0, 0, 0, 0, 0.2, 0};
  const Vector y = triad_response<double>(t, {10, 20, 30}, {0, 4, 5}, 10);
  EXPECT_NEAR(y[0], 1 + 1 + 15 + 0.01 * 20 + 0.02 * 30 + 0.5, 1e-12);
  EXPECT_NEAR(y[1], 2 + 20 + 0.03 * 10 + 0.04 * 30, 1e-12);
  EXPECT_NEAR(y[2], 3 + 30 + 0.05 * 10 + 0.06 * 20 + 0.2 * 4, 1e-12);
}

TEST(ImuModel, IsCutAtItsRangeAndRoundedToItsDigits) {
  ImuModel m;
  m.gyroscope.range = 2;
  m.gyroscope.resolution = 0.25;
  ImuErrors e(m, key_of(1), kPeriod);
  EXPECT_EQ(e.measure(0, 0, {}, {3, -3, 0.6}).angular_rate_radps, (Vector{2, -2, 0.5}));
  EXPECT_EQ(e.measure(0, 0, {100, 0, 0}, {}).specific_force_mps2, (Vector{100, 0, 0}));
}

TEST(ImuModel, WarmsUpAndDriftsWithIt) {
  ImuModel m;
  m.accelerometer.bias_per_k = {0.01, 0, 0};
  m.tells_temperature = true;
  m.ambient_c = 15;
  m.warm_up_k = 20;
  m.warm_up_time_s = 100;
  m.temperature_resolution_k = 0.5;
  ImuErrors e(m, key_of(1), kPeriod);
  const ImuSample cold = e.measure(0, 0, {}, {}), warm = e.measure(1, 1e4, {}, {});
  EXPECT_EQ(cold.temperature_c, 15);
  EXPECT_EQ(warm.temperature_c, 35);
  EXPECT_NEAR(cold.specific_force_mps2[0], -0.1, 1e-12);
  EXPECT_NEAR(warm.specific_force_mps2[0], 0.1, 1e-9);
  EXPECT_EQ(e.measure(2, 100, {}, {}).temperature_c, 27.5);  // 15 + 20·(1 − 1/e) = 27.64
}

TEST(ImuModel, GivesTheSameBytesForTheSameIndex) {
  ImuErrors a(noisy(), key_of(1), kPeriod), b(noisy(), key_of(1), kPeriod), c(noisy(), key_of(2), kPeriod);
  for (std::uint64_t i = 0; i < 500; ++i) (void)a.measure(i, 0, {}, {});
  const ImuSample x = a.measure(123, 0, {1, 2, 3}, {4, 5, 6}), y = b.measure(123, 0, {1, 2, 3}, {4, 5, 6});
  EXPECT_EQ(x.specific_force_mps2, y.specific_force_mps2);
  EXPECT_EQ(x.angular_rate_radps, y.angular_rate_radps);
  EXPECT_NE(x.angular_rate_radps, c.measure(123, 0, {1, 2, 3}, {4, 5, 6}).angular_rate_radps);
}

TEST(ImuModel, DrawsDevicesWithTheModelsSigmas) {
  ImuModel m;
  m.accelerometer.bias = {5, 0, 0};
  m.accelerometer.bias_sigma = 0.5;
  m.gyroscope.misalignment_sigma = 0.01;
  m.gyroscope.g_sensitivity_sigma = 2;
  test::Mean bias, bias_squares, mixed, sensitivity, between;
  for (int seed = 0; seed < 1000; ++seed) {
    const ImuModel d = draw_device(m, key_of(seed));
    bias.add(d.accelerometer.bias[0]);
    bias_squares.add(std::pow(d.accelerometer.bias[0] - 5, 2));
    for (const double v : d.gyroscope.misalignment) mixed.add(v * v);
    for (const double v : d.gyroscope.g_sensitivity) sensitivity.add(v * v);
    between.add((d.accelerometer.bias[0] - 5) * d.gyroscope.misalignment[0]);
    EXPECT_EQ(d.accelerometer.bias_sigma, 0);
  }
  test::expect_mean(bias, 5, "bias");
  test::expect_mean(bias_squares, 0.25, "variance of the bias");
  test::expect_mean(mixed, 1e-4, "variance of the misalignment");
  test::expect_mean(sensitivity, 4, "variance of the g-sensitivity");
  test::expect_mean(between, 0, "covariance");
}

Result<ImuModel> parsed(const char* text) {
  return parse_imu_model(*ConfigDocument::parse(text, "imu.yaml"));
}

TEST(ImuYaml, ConvertsTheUnitsOfDataSheets) {
  const auto m = parsed(R"(
accelerometer:
  bias_mg: [1, 0, 0]
  noise_density_ug_per_sqrt_hz: [100, 200, 300]
  instability_mg: 0.1
  random_walk_mg_per_sqrt_h: 6
  range_g: 6
gyroscope:
  angle_random_walk_deg_per_sqrt_h: [0.3]
  instability_deg_per_h: 2
  random_walk_deg_per_h_per_sqrt_h: 60
  g_sensitivity_sigma_deg_per_s_per_g: 0.1
  resolution_deg_per_s: 0.01
delay_ms: 2
)");
  ASSERT_TRUE(m) << m.error().text();
  constexpr double kDegree = M_PI / 180;
  EXPECT_NEAR(m->accelerometer.bias[0], 9.80665e-3, 1e-15);
  EXPECT_NEAR(m->accelerometer.white[2], 300e-6 * 9.80665 / std::sqrt(2), 1e-15);
  EXPECT_NEAR(m->accelerometer.instability, 9.80665e-4, 1e-15);
  EXPECT_NEAR(m->accelerometer.random_walk, 9.80665e-4, 1e-15);  // 6 mg/√h: 0.1 mg/√s
  EXPECT_NEAR(m->accelerometer.range, 58.8399, 1e-10);
  for (const double n : m->gyroscope.white) EXPECT_NEAR(n, 0.005 * kDegree, 1e-15);
  EXPECT_NEAR(m->gyroscope.instability, 2 * kDegree / 3600, 1e-15);
  EXPECT_NEAR(m->gyroscope.random_walk, kDegree / 3600, 1e-15);
  EXPECT_NEAR(m->gyroscope.g_sensitivity_sigma, 0.1 * kDegree / 9.80665, 1e-15);
  EXPECT_NEAR(m->gyroscope.resolution, 0.01 * kDegree, 1e-15);
  EXPECT_EQ(m->delay_s, 2e-3);
}

TEST(ImuYaml, ComplainsWithThePlace) {
  const char* const bad[][2] = {
      {"accelerometer: {}", "gyroscope"},
      {"accelerometer: { bias_mgg: [0, 0, 0] }\ngyroscope: {}", "imu.yaml:1:"},
      {"accelerometer: { bias_sigma_mg: -1 }\ngyroscope: {}", "bias_sigma_mg"},
      {"accelerometer: { g_sensitivity_sigma_deg_per_s_per_g: 1 }\ngyroscope: {}", "unknown key"},
      {"accelerometer: {}\ngyroscope: { noise_density_deg_per_s_per_sqrt_hz: [1], "
       "angle_random_walk_deg_per_sqrt_h: [1] }",
       "got both"},
      {"accelerometer: { noise_density_ug_per_sqrt_hz: [1, 2] }\ngyroscope: {}",
       "one number in brackets or three"},
      {"accelerometer: { instability_time_s: 0 }\ngyroscope: {}", "instability_time_s"}};
  for (const auto& [text, what] : bad) {
    const auto m = parsed(text);
    ASSERT_FALSE(m) << text;
    EXPECT_THAT(m.error().text(), HasSubstr(what)) << text;
  }
}

}  // namespace
}  // namespace rigor::models
