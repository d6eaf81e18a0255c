#include "bench/motion/bench_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "sensor-hal/models/philox.h"

namespace rigor {
namespace {

class BenchMotionTest : public ::testing::Test {
 protected:
  BenchMotionTest() {
    description.names = {"position", "rate"};
    EXPECT_TRUE(motion.bind(0, {"table", "channel", "position", "rate", std::numbers::pi / 180},
                            {"channel", &description, &port}));
    motion.set_joint_count(1);
    port.configure({.period = milliseconds(10)}, BenchTime(0));
  }
  void report(std::int64_t t_ms, double position_deg, double rate_degps) {
    SampleSlot s = pool.try_acquire();
    s->stamp.sequence = sequence++;
    s->stamp.t_capture = s->stamp.t_release = BenchTime(0) + milliseconds(t_ms);
    RegisterBlock block;
    block.count = 2;
    block.value[0] = position_deg;
    block.value[1] = rate_degps;
    s->info = block;
    port.push(std::move(s));
    port.advance(BenchTime(0) + milliseconds(t_ms), true);
    motion.update(BenchTime(0) + milliseconds(t_ms));
  }
  double degrees_at(std::int64_t t_ms) {
    const BenchTime t = BenchTime(0) + milliseconds(t_ms);
    return motion.motion_at(t).joint[0].at(t) * 180 / std::numbers::pi;
  }
  SamplePool pool{4};
  ChannelDescription description;
  SamplePort port;
  BenchMotion motion;
  std::uint64_t sequence = 0;
};

TEST_F(BenchMotionTest, RestsAtZeroBeforeTheFirstReport) { EXPECT_EQ(degrees_at(5), 0); }

TEST_F(BenchMotionTest, ExtrapolatesTheNewestReportWithItsRate) {
  report(10, 1.0, 50);
  EXPECT_NEAR(degrees_at(14), 1.2, 1e-12);
}

TEST_F(BenchMotionTest, InterpolatesBetweenReportsAndNotWithTheRateOfOne) {
  report(10, 1.0, 0);
  report(20, 2.0, 0);
  report(30, 4.0, 0);
  EXPECT_NEAR(degrees_at(15), 1.5, 1e-12);
  EXPECT_NEAR(degrees_at(25), 3.0, 1e-12);
  EXPECT_NEAR(degrees_at(30), 4.0, 1e-12);
}

TEST_F(BenchMotionTest, GoesTheShortWayRoundWhenThePositionWraps) {
  report(10, 179, 200);
  report(20, -179, 200);
  EXPECT_NEAR(std::remainder(degrees_at(15) - 180, 360), 0, 1e-9);
}

TEST_F(BenchMotionTest, BeginsAnewWhenAClockStepsBack) {
  report(100, 10, 0);
  port = SamplePort();
  port.configure({.period = milliseconds(10)}, BenchTime(0));
  report(50, 3, 0);
  EXPECT_NEAR(degrees_at(100), 3, 1e-12);
}

/// A joint whose device reports every 10 ms, a request past the newest report, and a sweep of 100 ms from
/// there.
struct Swept {
  double worst_deg = 0;               ///< over all sweeps
  double worst_interpolated_deg = 0;  ///< of sweeps that the bench learns of 150 ms later
};
Swept sweep(const std::function<double(double)>& position_deg,
            const std::function<double(double)>& rate_degps, double end_s) {
  BenchMotion motion;
  ChannelDescription description;
  description.names = {"position", "rate"};
  SamplePool pool{4};
  SamplePort port;
  port.configure({.period = milliseconds(10)}, BenchTime(0));
  EXPECT_TRUE(motion.bind(0, {"table", "channel", "position", "rate", std::numbers::pi / 180},
                          {"channel", &description, &port}));
  motion.set_joint_count(1);
  Swept swept;
  const auto error = [&](const JointState& s, BenchTime t) {
    return std::abs(s.at(t) * 180 / std::numbers::pi - position_deg((t - BenchTime(0)).seconds()));
  };
  std::uint64_t k = 0;
  for (std::int64_t ms = 10; ms <= static_cast<std::int64_t>(end_s * 1e3); ms += 10) {
    const BenchTime t = BenchTime(0) + milliseconds(ms);
    SampleSlot s = pool.try_acquire();
    s->stamp.sequence = k++;
    s->stamp.t_capture = s->stamp.t_release = t;
    RegisterBlock block;
    block.count = 2;
    block.value[0] = position_deg((t - BenchTime(0)).seconds());
    block.value[1] = rate_degps((t - BenchTime(0)).seconds());
    s->info = block;
    port.push(std::move(s));
    port.advance(t, true);
    motion.update(t);
    if (ms < 300) continue;
    const JointState now = motion.motion_at(t).joint[0];
    const JointState then = motion.motion_at(t - milliseconds(150)).joint[0];
    for (int i = 0; i <= 10; ++i) {
      swept.worst_deg = std::max(swept.worst_deg, error(now, t + milliseconds(10 * i)));
      swept.worst_interpolated_deg =
          std::max(swept.worst_interpolated_deg, error(then, t - milliseconds(150 - 10 * i)));
    }
  }
  return swept;
}
constexpr double kPeriod_s = 6, kOmega = 2 * std::numbers::pi / kPeriod_s;

/// At constant rate 0.105°: half the acceleration, 20.9 °/s², times the square of 100 ms.
TEST(BenchMotionSweep, FollowsASineOf20DegreesPerSecondToWithin15ThousandthsOfADegree) {
  const Swept swept = sweep([](double t) { return -20 / kOmega * std::cos(kOmega * t); },
                            [](double t) { return 20 * std::sin(kOmega * t); }, 2 * kPeriod_s);
  EXPECT_LT(swept.worst_deg, 0.015);
  EXPECT_LT(swept.worst_interpolated_deg, 0.005);
  RecordProperty("worst_deg", std::to_string(swept.worst_deg));
  RecordProperty("worst_interpolated_deg", std::to_string(swept.worst_interpolated_deg));
}

/// 90 °/s² for a second, then 90 °/s, braking, standing. The acceleration is known late by the span of the
/// fit; an error of α over 100 ms is 0.45°.
TEST(BenchMotionSweep, IsNoWorseThanAtConstantRateWhereAnAccelerationBeginsAndEnds) {
  const auto rate = [](double t) { return std::clamp(std::min(90 * (t - 1), 90 * (4 - t)), 0.0, 90.0); };
  const auto position = [](double t) {
    const auto ramp = [](double s) { return s <= 0 ? 0 : s < 1 ? 45 * s * s : 90 * s - 45; };
    return ramp(t - 1) - ramp(t - 3);
  };
  EXPECT_LT(sweep(position, rate, 5).worst_deg, 0.4501);
}

TEST_F(BenchMotionTest, ContinuesAConstantRateToTheBit) {
  for (int k = 1; k <= 40; ++k) report(10 * k, 0.1 * k, 10.0 / 3);
  for (const int t_ms : {400, 437, 600, 5000}) {
    const JointState s = motion.motion_at(BenchTime(0) + milliseconds(t_ms)).joint[0];
    EXPECT_EQ(s.t_ref, BenchTime(0) + milliseconds(400));
    EXPECT_EQ(s.position_rad, 0.1 * 40 * (std::numbers::pi / 180));
    EXPECT_EQ(s.rate_radps, 10.0 / 3 * (std::numbers::pi / 180));
    EXPECT_EQ(s.acceleration_radps2, 0);
  }
  const JointState between = motion.motion_at(BenchTime(0) + milliseconds(105)).joint[0];
  EXPECT_EQ(between.acceleration_radps2, 0);
  constexpr double kScale = std::numbers::pi / 180;
  EXPECT_EQ(between.rate_radps, (0.1 * 11 * kScale - 0.1 * 10 * kScale) / 0.01);
}

TEST_F(BenchMotionTest, TakesNoiseOfRatesForNoAcceleration) {
  int accelerated = 0;
  double worst_rad = 0;
  for (int k = 1; k <= 1000; ++k) {
    const auto u = models::philox({static_cast<std::uint32_t>(k), 0, 0, 0}, {1, 2});
    report(10 * k, 0.1 * k, 10 + 0.2 * (u[0] / 4294967296.0 - 0.5));
    const BenchTime t = BenchTime(0) + milliseconds(10 * k);
    const JointState s = motion.motion_at(t).joint[0];
    accelerated += s.acceleration_radps2 != 0;
    worst_rad =
        std::max(worst_rad, std::abs(s.at(t + milliseconds(100)) - (0.1 * k + 1) * std::numbers::pi / 180));
  }
  // Three standard errors of a fit with 13 degrees of freedom: 1 in 100 (Student's t), and neighbours share
  // their reports. The noise of the rate itself moves the end of a sweep by 0.01°.
  EXPECT_LT(accelerated, 40);
  EXPECT_LT(worst_rad * 180 / std::numbers::pi, 0.03);
}

TEST_F(BenchMotionTest, StandsWhereItStoppedOnceTheLatestThirdOfTheReportsStandsStill) {
  const auto rate = [](int k) { return std::max(0.0, 60.0 - 1.5 * k); };
  double position = 0;
  for (int k = 0; k <= 46; ++k) {
    if (k > 0) position += 0.01 * 0.5 * (rate(k - 1) + rate(k));
    report(10 * (k + 1), position, rate(k));
    const JointState s = motion.motion_at(BenchTime(0) + milliseconds(10 * (k + 1))).joint[0];
    const double a_degps2 = s.acceleration_radps2 * 180 / std::numbers::pi;
    if (k > 20 && k <= 40) {
      EXPECT_NEAR(a_degps2, -150, 1e-6) << k;
    }
    if (k >= 45) {
      EXPECT_EQ(a_degps2, 0) << k;
    }
  }
}

TEST_F(BenchMotionTest, NeedsFourReportsWithinTheSpanForAnAcceleration) {
  const auto acceleration = [&](int t_ms) {
    return motion.motion_at(BenchTime(0) + milliseconds(t_ms)).joint[0].acceleration_radps2;
  };
  EXPECT_EQ(acceleration(5), 0);
  for (int k = 1; k <= 3; ++k) {
    report(10 * k, 0.005 * k * k, k);
    EXPECT_EQ(acceleration(10 * k + 5), 0) << k;
  }
  report(40, 0.08, 4);
  EXPECT_NEAR(acceleration(45), 100 * std::numbers::pi / 180, 1e-9);
  // A gap as long as the span: begins anew, and a span between two reports is a straight line.
  report(240, 2.88, 24);
  EXPECT_EQ(acceleration(245), 0);
  EXPECT_EQ(acceleration(140), 0);
  EXPECT_NEAR(degrees_at(140), (0.08 + 2.88) / 2, 1e-12);
}

TEST_F(BenchMotionTest, EndsTheAccelerationOfASilentDeviceWhenTheSpanIsOver) {
  for (int k = 1; k <= 20; ++k) report(10 * k, 0.005 * k * k, k);
  const double end_deg = 0.5 * 100 * 0.35 * 0.35;
  EXPECT_NEAR(degrees_at(350), end_deg, 1e-9);
  EXPECT_NEAR(degrees_at(1350), end_deg + 35, 1e-9);
}

TEST_F(BenchMotionTest, DependsOnTheReportsAloneAndNotOnWhoAsked) {
  const auto drive = [&](bool ask) {
    BenchMotionTest::port = SamplePort();
    port.configure({.period = milliseconds(10)}, BenchTime(0));
    motion = BenchMotion();
    EXPECT_TRUE(motion.bind(0, {"table", "channel", "position", "rate", std::numbers::pi / 180},
                            {"channel", &description, &port}));
    motion.set_joint_count(1);
    sequence = 0;
    for (int k = 1; k <= 60; ++k) {
      report(10 * k, 3 * std::sin(0.1 * k), 30 * std::cos(0.1 * k));
      for (int i = 0; ask && i < 5; ++i) (void)motion.motion_at(BenchTime(0) + milliseconds(10 * k - 37 * i));
    }
  };
  drive(false);
  std::vector<double> quiet;
  for (int t_ms = 300; t_ms < 800; t_ms += 7) quiet.push_back(degrees_at(t_ms));
  drive(true);
  for (std::size_t i = 0; i < quiet.size(); ++i)
    EXPECT_EQ(quiet[i], degrees_at(300 + 7 * static_cast<int>(i)));
}

TEST(BenchMotionBody, ContinuesAnAccelerationThatItsPosesShow) {
  BenchMotion motion;
  ChannelDescription description;
  description.kind = SampleKind::pose;
  SamplePool pool{4};
  SamplePort port;
  port.configure({.period = milliseconds(10)}, BenchTime(0));
  EXPECT_TRUE(motion.follow(0, "robot", BodyState{}, {"truth", &description, &port}));
  for (int k = 1; k <= 30; ++k) {
    const BenchTime t = BenchTime(0) + milliseconds(10 * k);
    SampleSlot s = pool.try_acquire();
    s->stamp.sequence = static_cast<std::uint64_t>(k);
    s->stamp.t_capture = s->stamp.t_release = t;
    Pose pose;
    pose.position_m = {0.5 * 2 * 1e-4 * k * k, 0.01 * k, 0};
    s->info = pose;
    port.push(std::move(s));
    port.advance(t, true);
    motion.update(t);
  }
  const auto x_m = [&](int t_ms) {
    const BenchTime t = BenchTime(0) + milliseconds(t_ms);
    return motion.motion_at(t).body[0].at(t).position_m;
  };
  EXPECT_NEAR(x_m(400)[0], 0.16, 1e-9);  // at constant velocity 0.149
  EXPECT_NEAR(x_m(400)[1], 0.4, 1e-9);
  EXPECT_NEAR(x_m(600)[0], 0.2025 + 0.15 * 0.9, 1e-9);  // 150 ms of it
  EXPECT_NEAR(x_m(900)[0], x_m(800)[0], 1e-12);         // half a second in all
}

TEST_F(BenchMotionTest, RefusesARegisterThatTheChannelDoesNotHave) {
  BenchMotion other;
  const Status s = other.bind(0, {"table", "channel", "angle", "", 1}, {"channel", &description, &port});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().exit_status(), 2);
}

}  // namespace
}  // namespace rigor
