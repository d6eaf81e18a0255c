// The motion profiles: closed forms worked by hand, and limits that hold at every instant of many random
// moves.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sim/platform/turntable.h"

namespace rigor {
namespace {

using State = TurntableProfile::State;

BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }

TEST(TurntableProfile, RampsToARateAndStaysThere) {
  const auto p = profile_to_rate({.position_rad = 1, .rate_radps = 0}, at(2), -0.5, 2.0);
  EXPECT_EQ(p.at(at(1)).position_rad, 1);
  EXPECT_NEAR(p.at(at(2.1)).position_rad, 1 - 0.5 * 2 * 0.01, 1e-12);
  EXPECT_NEAR(p.at(at(2.1)).rate_radps, -0.2, 1e-12);
  EXPECT_NEAR(p.settled_after_s(), 0.25, 1e-12);
  // 0.25 s of ramp cover 0.0625 rad, the rest is uniform.
  EXPECT_NEAR(p.at(at(12)).position_rad, 1 - 0.0625 - 0.5 * 9.75, 1e-12);
  EXPECT_EQ(p.at(at(12)).acceleration_radps2, 0);
}

TEST(TurntableProfile, LongMoveIsATrapezoid) {
  // 3 rad at 1 rad/s and 2 rad/s²: 0.5 s up (0.25 rad), 2.5 s at rate, 0.5 s down.
  const auto p = profile_to_position({}, at(0), 3, 1, 2);
  EXPECT_NEAR(p.settled_after_s(), 3.5, 1e-12);
  EXPECT_NEAR(p.at(at(0.5)).position_rad, 0.25, 1e-12);
  EXPECT_NEAR(p.at(at(1.5)).position_rad, 1.25, 1e-12);
  EXPECT_NEAR(p.at(at(1.5)).rate_radps, 1, 1e-12);
  EXPECT_NEAR(p.at(at(3.25)).rate_radps, 0.5, 1e-12);
  EXPECT_NEAR(p.at(at(3.5)).position_rad, 3, 1e-12);
  EXPECT_FALSE(p.at(at(3.6)).moving);
}

TEST(TurntableProfile, ShortMoveIsATriangle) {
  // 0.5 rad at 2 rad/s²: 0.5 s up to 1 rad/s, 0.5 s down.
  const auto p = profile_to_position({}, at(0), -0.5, 100, 2);
  EXPECT_NEAR(p.settled_after_s(), 1.0, 1e-12);
  EXPECT_NEAR(p.at(at(0.5)).rate_radps, -1, 1e-12);
  EXPECT_NEAR(p.at(at(1.0)).position_rad, -0.5, 1e-12);
}

TEST(TurntableProfile, NoWayIsNoMotion) {
  const auto p = profile_to_position({.position_rad = 2}, at(0), 2, 1, 1);
  EXPECT_EQ(p.settled_after_s(), 0);
  EXPECT_EQ(p.at(at(5)).position_rad, 2);
  EXPECT_FALSE(p.at(at(0)).moving);
}

TEST(TurntableProfile, TurnsBackWhereItCannotStopInTime) {
  // At 2 rad/s with 2 rad/s² it needs 1 rad to stop, and the target is 0.5 rad ahead.
  const auto p = profile_to_position({.rate_radps = 2}, at(0), 0.5, 5, 2);
  EXPECT_NEAR(p.at(at(1)).position_rad, 1, 1e-12);
  EXPECT_LT(p.at(at(1.2)).rate_radps, 0);
  const auto end = p.at(at(10));
  EXPECT_NEAR(end.position_rad, 0.5, 1e-12);
  EXPECT_FALSE(end.moving);
}

TEST(TurntableProfile, BrakesToALowerRateFirst) {
  const auto p = profile_to_position({.rate_radps = 4}, at(0), 10, 1, 2);
  EXPECT_NEAR(p.at(at(1.5)).rate_radps, 1, 1e-12);
  EXPECT_NEAR(p.at(at(60)).position_rad, 10, 1e-9);
}

TEST(TurntableProfile, RandomMovesKeepTheirLimitsAndArrive) {
  std::mt19937_64 random(7);
  const auto uniform = [&](double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(random);
  };
  for (int i = 0; i < 3000; ++i) {
    const double a = uniform(0.1, 10), rate = uniform(0.05, 5);
    const State from{.position_rad = uniform(-20, 20), .rate_radps = uniform(-6, 6)};
    const double target = i % 3 == 0 ? from.position_rad + uniform(-0.1, 0.1) : uniform(-20, 20);
    const auto p = profile_to_position(from, at(0), target, rate, a);
    const double end_s = p.settled_after_s();
    const double limit = std::max(rate, std::fabs(from.rate_radps)) + 1e-9;
    State before = p.at(at(0));
    ASSERT_EQ(before.position_rad, from.position_rad);
    constexpr int kSteps = 200;
    for (int k = 1; k <= kSteps; ++k) {
      const auto s = p.at(at(end_s * k / kSteps));
      const double dt = end_s / kSteps;
      ASSERT_LE(std::fabs(s.rate_radps), limit);
      ASSERT_LE(std::fabs(s.rate_radps - before.rate_radps), a * dt + 1e-7);
      // The angle is the integral of the rate: no step hides between two instants.
      ASSERT_NEAR(s.position_rad - before.position_rad, 0.5 * (s.rate_radps + before.rate_radps) * dt,
                  0.25 * a * dt * dt + 1e-7);
      before = s;
    }
    const auto end = p.at(at(end_s + 1));
    ASSERT_NEAR(end.position_rad, target, 1e-9) << i;
    ASSERT_FALSE(end.moving);
  }
}

TEST(TurntableProfile, TakesTheShortestTime) {
  // From a rate away from the target: brake (1 s, 1 rad further away), then 2 rad back.
  const auto p = profile_to_position({.rate_radps = -2}, at(0), 1, 100, 2);
  const double peak = std::sqrt(2 * 2.0);  // of a triangle over 2 rad at 2 rad/s²
  EXPECT_NEAR(p.settled_after_s(), 1 + 2 * peak / 2, 1e-12);
}

}  // namespace
}  // namespace rigor
