#include "bench/motion/bench_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

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

TEST_F(BenchMotionTest, RefusesARegisterThatTheChannelDoesNotHave) {
  BenchMotion other;
  const Status s = other.bind(0, {"table", "channel", "angle", "", 1}, {"channel", &description, &port});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().exit_status(), 2);
}

}  // namespace
}  // namespace rigor
