#include "rt-core/port.h"

#include <gtest/gtest.h>

namespace rigor {
namespace {

struct Thing {
  Stamp stamp;
};

BenchTime at_ms(std::int64_t ms) { return BenchTime(ms * 1'000'000); }

class PortTest : public testing::Test {
 protected:
  PortTest() : pool_(70) { port_.configure(timing_, at_ms(0)); }

  /// A sample measured at `capture_ms`, visible 5 ms later, that came at `arrival_ms`.
  void push(std::uint64_t sequence, std::int64_t capture_ms, std::int64_t arrival_ms,
            std::uint32_t lost = 0) {
    WritableSlot<Thing> slot = pool_.try_acquire();
    ASSERT_TRUE(slot);
    slot->stamp = Stamp{};
    slot->stamp.sequence = sequence;
    slot->stamp.t_capture = at_ms(capture_ms);
    slot->stamp.t_release = at_ms(capture_ms + 5);
    slot->stamp.t_arrival = at_ms(arrival_ms);
    slot->stamp.lost_before = lost;
    port_.push(std::move(slot));
  }
  PortStatus advance(std::int64_t ms, bool connected = true) {
    port_.advance(at_ms(ms), connected);
    return port_.status();
  }

  Pool<Thing> pool_;
  PortTiming timing_{milliseconds(10), milliseconds(1), milliseconds(100), LatePolicy::hold};
  Port<Thing> port_;
};

TEST_F(PortTest, NothingIsVisibleBeforeTheFirstSample) {
  EXPECT_EQ(advance(0), PortStatus::never);
  EXPECT_FALSE(port_.sample());
  EXPECT_EQ(port_.age(at_ms(3)).ns(), 0);
}

TEST_F(PortTest, ASampleThatIsEarlyWaitsForItsRelease) {
  push(0, 0, 1);
  EXPECT_EQ(advance(4), PortStatus::never);
  EXPECT_EQ(advance(5), PortStatus::fresh);
  EXPECT_EQ(port_.sample()->stamp.sequence, 0u);
  EXPECT_EQ(port_.age(at_ms(7)), milliseconds(7));
  EXPECT_EQ(advance(6), PortStatus::held);
  EXPECT_EQ(port_.sample()->stamp.sequence, 0u);
  EXPECT_EQ(port_.counters().late_samples, 0u);
}

TEST_F(PortTest, TheSameSamplesGiveTheSameSequenceHoweverEarlyTheyCame) {
  std::vector<PortStatus> first;
  for (const std::int64_t early : {1, 4}) {
    Port<Thing> port;
    port.configure(timing_, at_ms(0));
    std::vector<PortStatus> seen;
    std::uint64_t next = 0;
    for (std::int64_t ms = 0; ms < 60; ++ms) {
      while (static_cast<std::int64_t>(next) * 10 + early <= ms) {
        WritableSlot<Thing> slot = pool_.try_acquire();
        slot->stamp = Stamp{.sequence = next,
                            .t_capture = at_ms(static_cast<std::int64_t>(next) * 10),
                            .t_release = at_ms(static_cast<std::int64_t>(next) * 10 + 5),
                            .t_arrival = at_ms(ms)};
        port.push(std::move(slot));
        ++next;
      }
      port.advance(at_ms(ms), true);
      seen.push_back(port.status());
    }
    if (first.empty()) first = seen;
    EXPECT_EQ(seen, first);
  }
}

TEST_F(PortTest, ASampleThatIsOverdueMakesThePortLateAndAppearsWhenItComes) {
  push(0, 0, 1);
  EXPECT_EQ(advance(5), PortStatus::fresh);
  EXPECT_EQ(advance(16), PortStatus::held);  // due at 15, tolerance 1
  EXPECT_EQ(advance(17), PortStatus::overdue);
  EXPECT_EQ(port_.sample()->stamp.sequence, 0u);  // policy hold
  push(1, 10, 18);
  EXPECT_EQ(advance(18), PortStatus::fresh);
  EXPECT_EQ(port_.sample()->stamp.sequence, 1u);
  EXPECT_EQ(port_.counters().overdue_cycles, 1u);
  EXPECT_EQ(port_.counters().late_samples, 1u);
  EXPECT_EQ(port_.counters().fresh, 2u);
}

TEST_F(PortTest, DropPolicyTakesTheOldSampleAway) {
  timing_.on_late = LatePolicy::drop;
  port_.configure(timing_, at_ms(0));
  push(0, 0, 1);
  advance(5);
  EXPECT_EQ(advance(17), PortStatus::overdue);
  EXPECT_FALSE(port_.sample());
  EXPECT_EQ(pool_.in_use(), 0u);
  push(1, 10, 18);
  EXPECT_EQ(advance(18), PortStatus::fresh);
  EXPECT_TRUE(port_.sample());
}

TEST_F(PortTest, OfTwoSamplesInOneCycleTheNewerIsVisibleAndTheOtherCounted) {
  push(0, 0, 1);
  push(1, 10, 11);
  EXPECT_EQ(advance(20), PortStatus::fresh);
  EXPECT_EQ(port_.sample()->stamp.sequence, 1u);
  EXPECT_EQ(port_.counters().superseded, 1u);
  EXPECT_EQ(port_.counters().fresh, 1u);
}

TEST_F(PortTest, ASourceThatIsGoneOrSilentIsLost) {
  push(0, 0, 1);
  advance(5);
  EXPECT_EQ(advance(8, false), PortStatus::disconnected);
  EXPECT_EQ(advance(9, true), PortStatus::held);
  EXPECT_EQ(advance(104), PortStatus::overdue);
  EXPECT_EQ(advance(106), PortStatus::disconnected);
  EXPECT_EQ(port_.counters().disconnected_cycles, 2u);
  push(9, 90, 107);
  EXPECT_EQ(advance(107), PortStatus::fresh);
}

TEST_F(PortTest, ASourceThatNeverSpokeIsLostAfterItsTime) {
  EXPECT_EQ(advance(100), PortStatus::never);
  EXPECT_EQ(advance(101), PortStatus::disconnected);
}

TEST_F(PortTest, WhatWaitsForItsReleaseIsStillSeenWhenTheSourceIsGone) {
  push(0, 0, 1);
  EXPECT_EQ(advance(3, false), PortStatus::never);
  EXPECT_EQ(advance(5, false), PortStatus::fresh);
  EXPECT_EQ(advance(6, false), PortStatus::disconnected);
}

TEST_F(PortTest, AnAperiodicChannelIsNeverLate) {
  timing_.period = Duration(0);
  port_.configure(timing_, at_ms(0));
  push(0, 0, 1);
  EXPECT_EQ(advance(5), PortStatus::fresh);
  EXPECT_EQ(advance(5000), PortStatus::held);
}

TEST_F(PortTest, LossesAreCountedOnceFromGapsAndFromTheSource) {
  push(0, 0, 1);
  push(3, 30, 31);     // gap of 2
  push(4, 40, 41, 1);  // the source says 1, without a gap
  push(8, 80, 81, 3);  // both say 3
  advance(5);
  advance(200);
  EXPECT_EQ(port_.counters().lost_samples, 6u);
}

TEST_F(PortTest, TooManyWaitingSamplesAreCountedAndGivenBack) {
  for (std::uint64_t i = 0; i < Port<Thing>::kPending + 3; ++i) push(i, static_cast<std::int64_t>(i) * 10, 0);
  EXPECT_EQ(port_.counters().overflow, 3u);
  EXPECT_EQ(pool_.in_use(), Port<Thing>::kPending);
}

TEST_F(PortTest, ReplayObeysTheRecordAgainstTheClock) {
  push(0, 0, 1);
  push(1, 10, 11);
  push(2, 20, 21);
  EXPECT_TRUE(port_.obey(PortStatus::never, 0, at_ms(6)));  // due by the clock, but the record says otherwise
  EXPECT_EQ(port_.status(), PortStatus::never);
  EXPECT_TRUE(port_.obey(PortStatus::fresh, 1, at_ms(7)));
  EXPECT_EQ(port_.sample()->stamp.sequence, 1u);
  EXPECT_EQ(port_.counters().superseded, 1u);
  EXPECT_TRUE(port_.obey(PortStatus::overdue, 0, at_ms(30)));
  EXPECT_EQ(port_.sample()->stamp.sequence, 1u);
  EXPECT_TRUE(port_.obey(PortStatus::disconnected, 0, at_ms(31)));
  EXPECT_EQ(port_.status(), PortStatus::disconnected);
  EXPECT_TRUE(port_.obey(PortStatus::fresh, 2, at_ms(32)));
  EXPECT_FALSE(port_.obey(PortStatus::fresh, 7, at_ms(33))) << "a sample that is not there is said";
  EXPECT_EQ(port_.counters().fresh, 2u);
}

}  // namespace
}  // namespace rigor
