#include "drivers/v4l2/frame_instant.h"

#include "tests/drivers/v4l2/v4l2_test_tools.h"

namespace rigor::v4l2 {
namespace {

constexpr Shutter kRolling{
    .exposure = milliseconds(8), .readout = milliseconds(20), .period = milliseconds(33)};
constexpr Shutter kGlobal{.exposure = milliseconds(8),
                          .readout = milliseconds(20),
                          .exposure_known = true,
                          .global = true,
                          .period = milliseconds(33)};

TEST(FrameInstant, IsTheMiddleOfTheCentreRowsExposure) {
  // Rolling: first row 0…8 ms, last row 20…28 ms, centre row 10…18 ms. Global: 0…8 ms, read out by 28 ms.
  EXPECT_EQ(event_to_capture(TimestampEvent::start_of_exposure, kRolling), milliseconds(14));
  EXPECT_EQ(event_to_capture(TimestampEvent::end_of_frame, kRolling), milliseconds(14 - 28));
  EXPECT_EQ(event_to_capture(TimestampEvent::start_of_exposure, kGlobal), milliseconds(4));
  EXPECT_EQ(event_to_capture(TimestampEvent::end_of_frame, kGlobal), milliseconds(4 - 28));
}

RawFrame frame(TimestampClock clock, std::int64_t timestamp_ns, BenchTime taken) {
  RawFrame f;
  f.clock = clock, f.timestamp_ns = timestamp_ns, f.t_taken = taken;
  return f;
}

TEST(FrameInstant, TakesTheClockThatTheStampIsOf) {
  const BenchTime now(1'000'000'000'000);
  const Duration ahead = seconds(1'700'000'000);
  const auto monotonic = frame_instant(frame(TimestampClock::monotonic, now.ns(), now), kRolling, ahead);
  EXPECT_TRUE(monotonic.sure);
  EXPECT_EQ(monotonic.t, now - milliseconds(14));
  // Copied stamps of a writer that uses CLOCK_REALTIME.
  const auto copied = frame_instant(frame(TimestampClock::copied, (now + ahead).ns(), now), kRolling, ahead);
  EXPECT_TRUE(copied.sure);
  EXPECT_EQ(copied.t, now - milliseconds(14));
  const auto same =
      frame_instant(frame(TimestampClock::unknown, (now - milliseconds(3)).ns(), now), kRolling, ahead);
  EXPECT_TRUE(same.sure);
  EXPECT_EQ(same.t, now - milliseconds(17));
  const auto ahead_of_itself =
      frame_instant(frame(TimestampClock::monotonic, (now + milliseconds(20)).ns(), now), kRolling, ahead);
  EXPECT_FALSE(ahead_of_itself.sure);
  EXPECT_EQ(ahead_of_itself.t, now - milliseconds(14));
  // Neither: the frame's arrival stands for the end of the frame, and says so.
  const auto none = frame_instant(frame(TimestampClock::unknown, 42, now), kRolling, ahead);
  EXPECT_FALSE(none.sure);
  EXPECT_EQ(none.t, now - milliseconds(14));
  EXPECT_GT(none.sigma, milliseconds(5));
}

TEST(FrameInstant, SaysHowLittleItKnowsWithoutAnExposure) {
  const BenchTime now(1'000'000'000'000);
  Shutter unknown = kRolling;
  unknown.exposure = {}, unknown.exposure_known = false;
  const auto f = frame_instant(frame(TimestampClock::monotonic, now.ns(), now), unknown, {});
  // Uniform over half a period: 16.5 ms / √12.
  EXPECT_NEAR(f.sigma.seconds() * 1e3, 16.5 / std::sqrt(12.0), 0.01);
  EXPECT_LT(frame_instant(frame(TimestampClock::monotonic, now.ns(), now), kRolling, {}).sigma,
            microseconds(1));
}

TEST(CaptureCount, FollowsTheDevicesCountOverItsEnd) {
  CaptureCount c(milliseconds(10));
  BenchTime t(0);
  EXPECT_EQ(c.step(0xFFFFFFFE, t).sequence, 0u);
  EXPECT_EQ(c.step(0xFFFFFFFF, t).sequence, 1u);
  const auto s = c.step(2, t);  // 0 and 1 are missing
  EXPECT_EQ(s.sequence, 4u);
  EXPECT_EQ(s.lost, 2u);
}

TEST(CaptureCount, LeavesOutWhatALaterCaptureHasOvertaken) {
  CaptureCount c(milliseconds(10));
  (void)c.step(7, BenchTime(0));
  EXPECT_EQ(c.step(9, BenchTime(0) + milliseconds(20)).lost, 1u);
  EXPECT_TRUE(c.step(8, BenchTime(0) + milliseconds(10)).late);
  const auto s = c.step(10, BenchTime(0) + milliseconds(30));
  EXPECT_FALSE(s.late);
  EXPECT_EQ(s.lost, 0u);
  EXPECT_EQ(s.sequence, 3u);
  // A device that began anew is no late frame.
  EXPECT_EQ(c.step(0, BenchTime(0) + milliseconds(40)).sequence, 4u);
}

TEST(CaptureCount, TellsGapsFromTheTimeWhereTheDeviceDoesNotCount) {
  CaptureCount c(milliseconds(10));
  (void)c.step(0, BenchTime(0));
  EXPECT_EQ(c.step(0, BenchTime(0) + milliseconds(11)).lost, 0u);
  const auto s = c.step(0, BenchTime(0) + milliseconds(41));
  EXPECT_EQ(s.lost, 2u);
  EXPECT_EQ(s.sequence, 4u);
}

TEST(CaptureCount, GoesOnByTheTimeWhenTheDeviceIsBack) {
  CaptureCount c(milliseconds(10));
  (void)c.step(500, BenchTime(0));
  c.restart();
  const auto s = c.step(3, BenchTime(0) + milliseconds(100));
  EXPECT_EQ(s.lost, 9u);
  EXPECT_EQ(s.sequence, 10u);
  EXPECT_EQ(c.give_up_until(BenchTime(0) + milliseconds(155)), 5u);
  EXPECT_EQ(c.step(9, BenchTime(0) + milliseconds(160)).sequence, 16u);
}

}  // namespace
}  // namespace rigor::v4l2
