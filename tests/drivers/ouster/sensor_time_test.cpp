// How a sensor counts time, and when its encoder passes the angle of phase lock.
#include "drivers/ouster/sensor_time.h"

#include <gtest/gtest.h>

#include <cmath>

namespace rigor::ouster {
namespace {

constexpr RealtimeTime kOn(1'700'000'000'400'000'000);   // switched on 0.4 s after a full second
constexpr RealtimeTime kNow(1'700'000'007'250'000'000);  // 6.85 s later

TEST(OusterTime, CountsByItsTimestampMode) {
  SensorTime t;
  EXPECT_EQ(t.count_at(kNow, kOn), 6'850'000'000U) << "since it was switched on";
  t.mode = SensorTime::Mode::sync_pulse;
  EXPECT_EQ(t.count_at(kNow, kOn), 7'250'000'000U)
      << "pulses since it was switched on, and the time since the last";
  t.nmea = true;
  EXPECT_EQ(t.count_at(kNow, kOn), 1'700'000'007'250'000'000U) << "UTC";
  t.nmea_leap = seconds(37);
  EXPECT_EQ(t.count_at(kNow, kOn), 1'700'000'044'250'000'000U);
  t.mode = SensorTime::Mode::ptp;
  EXPECT_EQ(t.count_at(kNow, kOn), 1'700'000'044'250'000'000U) << "TAI";
}

TEST(OusterTime, WithoutPhaseLockFramesBeginAtOnce) {
  EXPECT_EQ(SensorTime{}.first_frame(kNow, milliseconds(100)), kNow);
}

TEST(OusterTime, WithPhaseLockTheEncoderPassesTheAngleAtTheFullSecond) {
  for (const std::int64_t rate : {5, 10, 20})
    for (const double angle : {0.0, 0.001, 45.0, 90.0, 180.0, 270.0, 359.999, 360.0}) {
      SensorTime t;
      t.phase_lock = true;
      t.phase_lock_deg = angle;
      const Duration frame(1'000'000'000 / rate);
      const RealtimeTime first = t.first_frame(kNow, frame);
      ASSERT_GE(first, kNow);
      ASSERT_LT(first - kNow, frame) << "no later than needed";
      // Where the encoder stands at the next full second: it begins at 360 degrees and counts down.
      const std::int64_t to_second = 1'000'000'000 - first.ns() % 1'000'000'000;
      const double turns = static_cast<double>(to_second % frame.ns()) / static_cast<double>(frame.ns());
      const double encoder = 360 - turns * 360;
      const double off = std::abs(std::remainder(encoder - angle, 360.0));
      // Nanoseconds: of a turn in 50 ms at most 7.2e-6 degrees.
      EXPECT_LT(off, 1e-5) << angle << " degrees at " << rate << " Hz";
    }
}

}  // namespace
}  // namespace rigor::ouster
