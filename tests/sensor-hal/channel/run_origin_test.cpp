// When a run begins, as threads that wait for it learn.
#include "sensor-hal/channel/run_origin.h"

#include <gtest/gtest.h>

#include <thread>

namespace rigor {
namespace {

BenchTime at_ms(std::int64_t ms) { return BenchTime(0) + milliseconds(ms); }

TEST(RunOrigin, IsKnownFromPublishingUntilItIsForgotten) {
  RunOrigin origin;
  EXPECT_FALSE(origin.get());
  EXPECT_FALSE(origin.covers(BenchTime::never(), milliseconds(1))) << "no run is known";
  origin.publish(BenchTime(0));
  ASSERT_TRUE(origin.get());
  EXPECT_EQ(*origin.get(), BenchTime(0));
  origin.forget();
  EXPECT_FALSE(origin.get());
}

TEST(RunOrigin, CoversCapturesFromHalfAPeriodBeforeTheRunOn) {
  RunOrigin origin;
  origin.publish(at_ms(1000));
  EXPECT_TRUE(origin.covers(at_ms(995), milliseconds(10)));
  EXPECT_FALSE(origin.covers(at_ms(995) - nanoseconds(1), milliseconds(10)));
  EXPECT_TRUE(origin.covers(at_ms(1000), {}));
  EXPECT_FALSE(origin.covers(at_ms(1000) - nanoseconds(1), {})) << "aperiodic";
}

TEST(RunOrigin, AThreadThatWaitsSeesItAndAllThatWasWrittenBefore) {
  for (int round = 0; round < 50; ++round) {
    RunOrigin origin;
    Deadline deadline;
    ASSERT_TRUE(deadline.open());
    int written = 0, seen = 0;
    BenchTime t0;
    std::thread waiting([&] {
      const auto got = origin.wait(deadline);
      if (!got) return;
      t0 = *got;
      seen = written;
    });
    if (round % 2 == 0) std::this_thread::sleep_for(std::chrono::microseconds(100 * round));
    written = round + 1;
    origin.publish(at_ms(round));
    waiting.join();
    EXPECT_EQ(t0, at_ms(round));
    EXPECT_EQ(seen, round + 1);
  }
}

TEST(RunOrigin, AWaitThatIsCutEndsWithoutOne) {
  RunOrigin origin;
  Deadline deadline;
  ASSERT_TRUE(deadline.open());
  bool known = true;
  std::thread waiting([&] { known = origin.wait(deadline).has_value(); });
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  deadline.cut();
  waiting.join();
  EXPECT_FALSE(known);
}

//   device's count   40    41     42     43 …
//   capture (ms)    970   980  t0 990   1000          t0 = 990 ms: 42 is the first of the run
TEST(RunSequence, CountsFromTheFirstCaptureOfTheRun) {
  RunOrigin origin;
  RunSequence in_run;
  const Duration period = milliseconds(10);
  EXPECT_FALSE(in_run.place(origin, at_ms(970), period, 40, 0));
  origin.publish(at_ms(990));
  EXPECT_FALSE(in_run.place(origin, at_ms(980), period, 41, 0));
  auto p = in_run.place(origin, at_ms(990), period, 42, 0);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->sequence, 0u);
  EXPECT_EQ(p->lost, 0u);
  p = in_run.place(origin, at_ms(1020), period, 45, 2);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->sequence, 3u);
  EXPECT_EQ(p->lost, 2u);
  in_run.reset();
  EXPECT_EQ(in_run.place(origin, at_ms(1030), period, 46, 0)->sequence, 0u) << "of the next run";
}

TEST(RunSequence, OfTheCapturesLostBeforeTheFirstThoseOfTheRunCount) {
  RunOrigin origin;
  origin.publish(at_ms(990));
  RunSequence in_run;
  // 41 to 45 were lost, at 970 to 1010 ms; 43, 44 and 45 are of the run.
  const auto p = in_run.place(origin, at_ms(1020), milliseconds(10), 46, 5);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->lost, 3u);
  EXPECT_EQ(p->sequence, 3u);
  RunSequence aperiodic;
  const auto q = aperiodic.place(origin, at_ms(1020), {}, 46, 5);
  ASSERT_TRUE(q);
  EXPECT_EQ(q->lost, 0u) << "when they were lost is not known";
  EXPECT_EQ(q->sequence, 0u);
}

}  // namespace
}  // namespace rigor
