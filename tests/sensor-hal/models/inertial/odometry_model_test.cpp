#include "sensor-hal/models/odometry/odometry_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "sensor-hal/models/odometry/odometry_yaml.h"
#include "tests/sensor-hal/models/inertial/statistics.h"

namespace rigor::models {
namespace {

using testing::HasSubstr;

const Duration kPeriod = milliseconds(20);
const PhiloxKey kKey = channel_key(1, 1);

OdometryModel plain() {
  OdometryModel m;
  m.wheel_radius_m = 0.2;
  m.track_m = 0.8;
  return m;
}
/// Wheels that turn evenly.
OdometryDevice::Wheels wheels_at(std::uint64_t index, double left_radps, double right_radps) {
  const double t_s = static_cast<double>(index) * kPeriod.seconds();
  return {{left_radps * t_s, right_radps * t_s}, {left_radps, right_radps}};
}
double yaw_of(const Pose& p) { return 2 * std::atan2(p.orientation_wxyz[3], p.orientation_wxyz[0]); }

TEST(Odometry, ComesBackAfterACircle) {
  OdometryDevice d(plain(), kKey, kPeriod);
  // Radius 2 m at 1 m/s: 0.5 rad/s; a turn takes 4π s.
  const double turn = 0.5, left = (1 - turn * 0.4) / 0.2, right = (1 + turn * 0.4) / 0.2;
  Odometry o;
  const auto quarter = static_cast<std::uint64_t>(M_PI / 0.02);
  for (std::uint64_t i = 0; i <= quarter; ++i) o = d.measure(i, {}, wheels_at(i, left, right));
  const double angle = turn * static_cast<double>(quarter) * 0.02;
  EXPECT_NEAR(o.T_odom_base.position_m[0], 2 * std::sin(angle), 1e-9);
  EXPECT_NEAR(o.T_odom_base.position_m[1], 2 * (1 - std::cos(angle)), 1e-9);
  EXPECT_NEAR(yaw_of(o.T_odom_base), angle, 1e-9);
  EXPECT_NEAR(o.velocity_mps[0], 1, 1e-9);
  EXPECT_NEAR(o.turn_rate_radps[2], turn, 1e-9);
}

TEST(Odometry, StandsAtItsOriginWithTheFirstCaptureAndAgainWithANewRun) {
  OdometryDevice d(plain(), kKey, kPeriod);
  EXPECT_EQ(d.measure(100, {}, wheels_at(100, 5, 5)).T_odom_base.position_m[0], 0);
  EXPECT_NEAR(d.measure(110, {}, wheels_at(110, 5, 5)).T_odom_base.position_m[0], 0.2, 1e-9) << "ten periods";
  const Odometry once = d.measure(111, {}, wheels_at(111, 5, 5));
  const Odometry again = d.measure(111, {}, wheels_at(111, 5, 5));
  EXPECT_EQ(once.T_odom_base.position_m, again.T_odom_base.position_m);
  EXPECT_EQ(once.wheel_rate_radps, again.wheel_rate_radps);
  EXPECT_EQ(d.measure(112, BenchTime(5), wheels_at(112, 5, 5)).T_odom_base.position_m[0], 0);
}

TEST(Odometry, CountsTicks) {
  OdometryModel m = plain();
  m.ticks_per_turn = 100;
  OdometryDevice d(m, kKey, kPeriod);
  const double tick = 2 * M_PI / 100;
  double sum = 0;
  for (std::uint64_t i = 0; i < 200; ++i) {
    const auto wheels = wheels_at(i, 1, -1);
    const Odometry o = d.measure(i, {}, wheels);
    for (std::size_t side = 0; side < 2; ++side) {
      const double ticks = o.wheel_angle_rad[side] / tick;
      ASSERT_NEAR(ticks, std::round(ticks), 1e-9);
      ASSERT_LE(std::abs(o.wheel_angle_rad[side] - wheels.angle_rad[side]), tick);
    }
    sum += o.wheel_rate_radps[0] * kPeriod.seconds();
  }
  EXPECT_NEAR(sum, 199 * 0.02, 2 * tick) << "rates add up to the angle";
}

TEST(Odometry, BelievesInItsOwnRadiiAndTrack) {
  OdometryModel m = plain();
  m.radius_error = {0.01, 0.03};
  m.track_error = 0.1;
  OdometryDevice d(m, kKey, kPeriod);
  const Odometry o = d.measure(0, {}, wheels_at(0, 10, 10));
  EXPECT_NEAR(o.velocity_mps[0], 2 * 1.02, 1e-12);
  EXPECT_NEAR(o.turn_rate_radps[2], 2 * 0.02 / (0.8 * 1.1), 1e-12);
  m = plain();
  m.radius_error_sigma = 0.01;
  test::Mean squares;
  for (int seed = 0; seed < 1000; ++seed) {
    OdometryDevice one(m, channel_key(static_cast<std::uint64_t>(seed), 1), kPeriod);
    const Odometry x = one.measure(0, {}, wheels_at(0, 10, 0));
    squares.add(std::pow(x.velocity_mps[0] - 1, 2));
  }
  test::expect_mean(squares, 1e-4, "variance of a radius");
}

TEST(Odometry, ClaimsToBeLessSureTheFartherItWent) {
  OdometryModel m = plain();
  m.position_per_m = 0.05;
  m.yaw_rad_per_m = 0.01;
  m.speed_mps = 0.1;
  OdometryDevice d(m, kKey, kPeriod);
  Odometry o;
  for (std::uint64_t i = 0; i <= 500; ++i) o = d.measure(i, {}, wheels_at(i, 5, 5));
  EXPECT_NEAR(std::sqrt(o.pose_variance[0]), 0.5, 1e-9);
  EXPECT_NEAR(std::sqrt(o.pose_variance[5]), 0.1, 1e-9);
  EXPECT_NEAR(o.twist_variance[0], 0.01, 1e-12);
}

TEST(OdometryYaml, ComplainsWithThePlace) {
  const char* const bad[][2] = {
      {"track_m: 1", "wheel_radius_m"},
      {"wheel_radius_m: 0\ntrack_m: 1", "wheel_radius_m"},
      {"wheel_radius_m: 1\ntrack_m: 1\nticks: 5", "odometry.yaml:3:1"},
      {"wheel_radius_m: 1\ntrack_m: 1\nradius_error_percent: [0, 80]", "-50 to 50"}};
  for (const auto& [text, what] : bad) {
    const auto m = parse_odometry_model(*ConfigDocument::parse(text, "odometry.yaml"));
    ASSERT_FALSE(m) << text;
    EXPECT_THAT(m.error().text(), HasSubstr(what)) << text;
  }
}

}  // namespace
}  // namespace rigor::models
