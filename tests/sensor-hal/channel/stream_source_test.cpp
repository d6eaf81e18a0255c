#include "sensor-hal/channel/stream_source.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <thread>
#include <vector>

#include "sensor-hal/channel/backoff.h"

namespace rigor {
namespace {

/// A source whose device is the test.
class Streamed final : public StreamSource {
 public:
  explicit Streamed(std::size_t slots) : slots_(slots) {}
  void come(std::int64_t release_ns) {
    auto slot = take_slot();
    if (slot) {
      slot->stamp.sequence = next_;
      slot->stamp.t_release = BenchTime(release_ns);
    }
    ++next_;
    hand_over(std::move(slot));
  }
  using StreamSource::count_lost;
  using StreamSource::for_each_slot;
  using StreamSource::hand_over;
  using StreamSource::lend_slot;
  void resize(std::size_t slots) { slots_ = slots; }

 protected:
  Status do_configure(const ChannelConfig&) override { return {}; }
  Status do_arm(const ArmContext& context) override {
    open_stream(slots_, 16, context.virtual_time);
    return {};
  }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override {
    close_stream();
    return {};
  }

 private:
  std::size_t slots_;
  std::uint64_t next_ = 0;
};

void bring_up(Streamed& source, bool virtual_time) {
  if (source.state() == ChannelState::created) {
    ASSERT_TRUE(source.configure({}));
  }
  ASSERT_TRUE(source.arm({.virtual_time = virtual_time}));
  ASSERT_TRUE(source.start(BenchTime(0)));
}

TEST(StreamSource, InVirtualTimeASampleIsNotSeenBeforeItsRelease) {
  Streamed source(4);
  bring_up(source, true);
  source.come(100);
  EXPECT_FALSE(source.poll(BenchTime(99)));
  EXPECT_TRUE(source.poll(BenchTime(100)));
}

TEST(StreamSource, InVirtualTimeASlotThatAnotherThreadHoldsIsWaitedFor) {
  Streamed source(2);
  bring_up(source, true);
  source.come(1);
  source.come(2);
  std::thread holder([a = source.poll(BenchTime(9)), b = source.poll(BenchTime(9))]() mutable {
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    a.reset();
    b.reset();
  });
  source.come(3);
  holder.join();
  EXPECT_EQ(source.health().no_slot, 0u);
  const auto third = source.poll(BenchTime(9));
  ASSERT_TRUE(third);
  EXPECT_EQ(third->stamp.sequence, 2u);
}

TEST(StreamSource, WithAllSlotsHeldASampleIsCountedAndTheNextOneTellsOfIt) {
  Streamed source(2);
  bring_up(source, false);
  source.come(1);
  source.come(2);
  source.come(3);  // no slot
  EXPECT_EQ(source.health().received, 3u);
  EXPECT_EQ(source.health().no_slot, 1u);
  EXPECT_EQ(source.poll(BenchTime(9))->stamp.sequence, 0u);
  EXPECT_EQ(source.poll(BenchTime(9))->stamp.sequence, 1u);
  source.count_lost(5);
  source.come(4);
  const auto told = source.poll(BenchTime(9));
  ASSERT_TRUE(told);
  EXPECT_EQ(told->stamp.lost_before, 6u);
  EXPECT_EQ(source.health().lost, 5u);
}

TEST(StreamSource, ThatIsNotPolledKeepsNoMoreThanARecorderTakesAtOnce) {
  for (const bool virtual_time : {false, true}) {
    Streamed source(16);
    bring_up(source, virtual_time);
    for (int i = 1; i <= 16; ++i) source.come(i);
    const std::size_t most =
        virtual_time ? 16 : 16 - kSlotsForTheLoop;  // nothing is left out in virtual time
    EXPECT_EQ(source.health().no_slot, 16 - most);
    std::vector<SampleLease> held;
    while (auto lease = source.poll(BenchTime(16))) held.push_back(std::move(lease));
    EXPECT_EQ(held.size(), most);
    if (virtual_time) continue;
    source.come(17);
    const auto next = source.poll(BenchTime(17));
    ASSERT_TRUE(next) << "the loop has slots although all samples are held";
    EXPECT_EQ(next->stamp.lost_before, kSlotsForTheLoop);
  }
}

TEST(StreamSource, SlotsLentToADeviceComeBackWithinTheSameLimit) {
  Streamed source(16);
  bring_up(source, false);
  std::vector<std::byte*> memory;
  source.for_each_slot([&](Sample& s) { memory.push_back(s.memory().data()); });
  EXPECT_EQ(memory.size(), 16u);
  // Two in the device's hands although nobody polls; more than may wait is dropped, and the device goes on.
  for (int i = 0; i < 20; ++i) {
    SampleSlot slot = source.lend_slot();
    ASSERT_TRUE(slot) << i;
    EXPECT_NE(std::find(memory.begin(), memory.end(), slot->memory().data()), memory.end());
    slot->stamp.sequence = static_cast<std::uint64_t>(i);
    source.hand_over(std::move(slot));
  }
  const std::size_t most = 16 - kSlotsForTheLoop;
  EXPECT_EQ(source.health().ring_full, 20 - most);
  std::size_t seen = 0;
  while (source.poll(BenchTime(0))) ++seen;
  EXPECT_EQ(seen, most);
  source.hand_over(source.lend_slot());
  EXPECT_EQ(source.poll(BenchTime(0))->stamp.lost_before, 20 - most);
}

TEST(StreamSource, LeasesOfAnEarlierRunOutliveTheNextArm) {
  Streamed source(2);
  bring_up(source, false);
  source.come(1);
  source.come(2);
  const auto held = source.poll(BenchTime(9));
  ASSERT_TRUE(source.stop());
  bring_up(source, false);
  source.come(3);
  EXPECT_EQ(held->stamp.sequence, 0u);
  const auto fresh = source.poll(BenchTime(9));
  ASSERT_TRUE(fresh) << "what the last run left unpolled holds no slot";
  EXPECT_EQ(fresh->stamp.sequence, 2u);
}

TEST(StreamSource, LeasesKeepTheirMemoryWhenTheNextRunHasOtherSlots) {
  SampleLease first, second;
  {
    Streamed source(2);
    bring_up(source, false);
    source.come(1);
    first = source.poll(BenchTime(9));
    ASSERT_TRUE(source.stop());
    source.resize(3);
    bring_up(source, false);
    source.come(2);
    second = source.poll(BenchTime(9));
    EXPECT_EQ(first->stamp.sequence, 0u);
    ASSERT_TRUE(source.stop());
  }
  EXPECT_EQ(first->stamp.sequence, 0u);
  EXPECT_EQ(second->stamp.sequence, 1u);
  SampleSlot slot = first.take_back();
  ASSERT_TRUE(slot);
  EXPECT_EQ(slot->memory().size(), 16u);
  slot->memory()[15] = std::byte{1};
}

TEST(Backoff, PausesDoubleFromFiftyMillisecondsToTwoSecondsAndStartAnew) {
  Backoff backoff;
  MonotonicTime now(1'000'000'000);
  EXPECT_TRUE(backoff.due(now));
  for (const std::int64_t ms : {50, 100, 200, 400, 800, 1600, 2000, 2000}) {
    backoff.failed(now);
    EXPECT_FALSE(backoff.due(now + milliseconds(ms - 1)));
    now = now + milliseconds(ms);
    EXPECT_TRUE(backoff.due(now));
  }
  backoff.reset();
  EXPECT_TRUE(backoff.due(now));
}

}  // namespace
}  // namespace rigor
