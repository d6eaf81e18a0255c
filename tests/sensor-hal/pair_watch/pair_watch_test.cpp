#include "sensor-hal/channel/pair_watch/pair_watch.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::pair_watch {
namespace {

using testing::Random;

WatchOptions options() {
  WatchOptions o;
  o.window_s = 1, o.baseline_windows = 50, o.false_alarms_per_h = 1e-3;
  return o;
}

Sample registers(double t_s, double a, double b) {
  Sample s;
  s.stamp.t_capture = BenchTime{} + seconds_from(t_s);
  RegisterBlock block;
  block.count = 4, block.value[1] = a, block.value[3] = b;
  s.info = block;
  return s;
}

/// 20 Hz; from the 100th second on the second register is 0.1 more.
void feed(PairWatch& watch, int from, int to, std::uint64_t seed) {
  Random random(seed);
  for (int i = from; i < to; ++i) {
    const double t = 0.05 * i;
    watch.add(registers(t, 5 + 0.01 * random.normal(), 7 + 0.02 * random.normal() + (t >= 100 ? 0.1 : 0)),
              registers(t, 5, 7 + 0.02 * random.normal()));
  }
}

PairWatch of_two() {
  return PairWatch::of_registers({{1, {"pressure", "bar", 0}}, {3, {"flow", "l/s", 0}}}, options()).value();
}

TEST(PairWatch, TellsWhatHasChangedAndSinceWhen) {
  PairWatch watch = of_two();
  feed(watch, 0, 2000, 1);
  PairWatchSnapshot s = watch.snapshot();
  EXPECT_EQ(s.state, WatchState::watching);
  EXPECT_EQ(s.compared, 2000u);
  EXPECT_EQ(s.windows, 99u);  // the hundredth is open
  EXPECT_EQ(s.parameters, 8u);
  EXPECT_EQ(s.alarms, 0u);
  EXPECT_EQ(text_of(watch, s), "");
  feed(watch, 2000, 2400, 2);
  s = watch.snapshot();
  ASSERT_EQ(s.state, WatchState::alarm);
  EXPECT_EQ(s.alarms, 1u);
  EXPECT_EQ(watch.parameters()[s.alarm.parameter].name, "flow bias");
  EXPECT_EQ((s.t_since - BenchTime{}).ns(), seconds(100).ns());
  EXPECT_LT((s.t_alarm - BenchTime{}).seconds(), 110);
  EXPECT_NEAR(s.alarm.change, 0.1, 0.02);
  const std::string text = text_of(watch, s);
  EXPECT_NE(text.find("flow bias has changed by +0."), std::string::npos) << text;
  EXPECT_NE(text.find(" l/s, since 100 s; next best: "), std::string::npos) << text;
  watch.acknowledge();
  feed(watch, 2400, 2800, 3);
  EXPECT_EQ(watch.snapshot().alarms, 2u);
}

TEST(PairWatch, WindowsAreThoseOfCaptureTime) {
  PairWatch watch = of_two();
  feed(watch, 0, 100, 1);    // 0 to 5 s
  feed(watch, 430, 485, 1);  // nothing until 21.5 s, in the middle of a window; then to 24.2 s
  EXPECT_EQ(watch.snapshot().windows, 8u);
  feed(watch, 200, 260, 1);  // set back to 10 s
  EXPECT_EQ(watch.snapshot().windows, 11u);
}

TEST(PairWatch, SamePairsGiveTheSameToTheLastBit) {
  PairWatch a = of_two(), b = of_two();
  feed(a, 0, 2300, 5);
  for (int i = 0; i < 2300; i += 100) (void)b.snapshot();
  feed(b, 0, 2300, 5);
  const PairWatchSnapshot x = a.snapshot(), y = b.snapshot();
  EXPECT_EQ(x.alarm.change, y.alarm.change);
  EXPECT_EQ(x.alarm.log_ratio, y.alarm.log_ratio);
  for (std::size_t i = 0; i < x.parameters; ++i) EXPECT_EQ(x.level[i], y.level[i]);
}

TEST(PairWatch, CountsWhatCannotBeCompared) {
  PairWatch watch = of_two();
  Sample few = registers(0, 1, 2);
  std::get<RegisterBlock>(few.info).count = 3;
  watch.add(few, registers(0, 1, 2));
  Sample other = registers(0, 1, 2);
  other.info = ImuSample{};
  watch.add(registers(0.1, 1, 2), other);
  EXPECT_EQ(watch.snapshot().unlike, 2u);
  EXPECT_EQ(watch.snapshot().compared, 0u);
}

TEST(PairWatch, InertialUnitsAreWatchedByAxis) {
  PairWatch watch = PairWatch::of_numbers(SampleKind::imu, options()).value();
  Random random(3);
  for (int i = 0; i < 12000; ++i) {
    Sample real, simulated;
    real.stamp.t_capture = simulated.stamp.t_capture = BenchTime{} + milliseconds(10 * i);
    ImuSample a, b;
    for (std::size_t k = 0; k < 3; ++k) {
      a.specific_force_mps2[k] = 0.05 * random.normal(), b.specific_force_mps2[k] = 0.05 * random.normal();
      a.angular_rate_radps[k] = 1e-3 * random.normal(), b.angular_rate_radps[k] = 1e-3 * random.normal();
    }
    if (i > 8000) a.angular_rate_radps[2] += 1e-3;
    real.info = a, simulated.info = b;
    watch.add(real, simulated);
  }
  ASSERT_EQ(watch.snapshot().state, WatchState::alarm);
  EXPECT_EQ(watch.parameters()[watch.snapshot().alarm.parameter].name, "angular rate z bias");
}

TEST(PairWatch, ReceiversAreWatchedByEastNorthAndUp) {
  // On a circle of 20 m, 1 Hz, windows of 10 s; the receiver's antenna is half a metre higher after 1000 s.
  WatchOptions o = options();
  o.window_s = 10;
  PairWatch watch = PairWatch::of_numbers(SampleKind::nav_fix, o).value();
  Random random(4);
  const auto fix = [&](double east_m, double north_m, double up_m) {
    NavFix f;  // at 50° north a second of arc is 30.9 m of latitude, 19.9 m of longitude
    f.status = FixStatus::fix;
    f.latitude_deg = 50 + (north_m + 0.05 * random.normal()) / 111229.0;
    f.longitude_deg = 180 - 1e-5 + (east_m + 0.05 * random.normal()) / 71696.0;
    if (f.longitude_deg > 180) f.longitude_deg -= 360;  // half of the circle lies beyond the date line
    f.height_m = 600 + up_m + 0.1 * random.normal();
    return f;
  };
  for (int i = 0; i < 2000 && watch.snapshot().state != WatchState::alarm; ++i) {
    const double a = 0.1 * i, x = 20 * std::cos(a), y = 20 * std::sin(a);
    Sample real, simulated;
    real.stamp.t_capture = simulated.stamp.t_capture = BenchTime{} + seconds(i);
    real.info = fix(x, y, i >= 1000 ? 0.5 : 0), simulated.info = fix(x, y, 0);
    if (i % 100 == 50) real.info = NavFix{};  // no fix
    watch.add(real, simulated);
  }
  const PairWatchSnapshot s = watch.snapshot();
  ASSERT_EQ(s.state, WatchState::alarm);
  EXPECT_GE(s.unlike, 10u) << "fixes that were none";
  EXPECT_EQ(watch.parameters()[s.alarm.parameter].name, "up bias");
  EXPECT_NEAR(s.alarm.change, 0.5, 0.1);
  EXPECT_EQ((s.t_since - BenchTime{}).ns(), seconds(1000).ns());
  EXPECT_NEAR(s.last.value[0], 0, 0.1) << "east, in metres";
  EXPECT_EQ(watch.parameters()[1].name, "east delay") << "a place has no scale";
  EXPECT_NEAR(s.last.value[1], 0, 0.1);
}

TEST(PairWatch, OdometryIsWatchedByItsVelocities) {
  PairWatch watch = PairWatch::of_numbers(SampleKind::odometry, options()).value();
  Random random(5);
  double x_m = 0;
  for (int i = 0; i < 3000 && watch.snapshot().state != WatchState::alarm; ++i) {
    const double t = 0.05 * i, v = 0.8 + 0.5 * std::sin(2 * t), turn = 0.4 * std::sin(1.3 * t);
    // From 100 s on the left tyre has lost air: its wheel turns faster by 3 %.
    const auto side = [&](double left) {
      Odometry o;
      o.velocity_mps[0] = v + 0.002 * random.normal(), o.turn_rate_radps[2] = turn + 0.002 * random.normal();
      o.wheel_rate_radps = {(v - 0.3 * turn) / 0.2 * left + 0.01 * random.normal(),
                            (v + 0.3 * turn) / 0.2 + 0.01 * random.normal()};
      return o;
    };
    Sample real, simulated;
    real.stamp.t_capture = simulated.stamp.t_capture = BenchTime{} + milliseconds(50 * i);
    Odometry o = side(t >= 100 ? 1.03 : 1);
    o.T_odom_base.position_m[0] = x_m += 0.01 * random.normal();  // wanders; nobody minds
    real.info = o, simulated.info = side(1);
    watch.add(real, simulated);
  }
  const PairWatchSnapshot s = watch.snapshot();
  ASSERT_EQ(s.state, WatchState::alarm);
  EXPECT_EQ(watch.parameters()[s.alarm.parameter].name, "left wheel scale");
  EXPECT_NEAR(s.alarm.change, 0.03, 0.005);
  EXPECT_FALSE(PairWatch::of_numbers(SampleKind::pose, options()));
}

TEST(PairWatch, RefusesWhatItsPartsRefuse) {
  EXPECT_FALSE(PairWatch::of_registers({{RegisterBlock::kMax, {"x", "1", 0}}}, options()));
  EXPECT_FALSE(PairWatch::of_registers({}, options()));
  WatchOptions o = options();
  o.window_s = 0;
  const auto watch = PairWatch::of_numbers(SampleKind::imu, o);
  ASSERT_FALSE(watch);
  EXPECT_EQ(watch.error().text(), "window_s: expected a length above 0, got 0.000000");
  EXPECT_FALSE(PairWatch::of_clouds({.points = 1}, options()));
  EXPECT_FALSE(PairWatch::of_range_images({2, 2}, {}, options()));
  EXPECT_FALSE(PairWatch::of_images(CameraModel{}, ImageInfo{}, {}, options()));
}

}  // namespace
}  // namespace rigor::pair_watch
