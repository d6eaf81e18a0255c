#include "drivers/aravis/frame_sequence.h"

#include <gtest/gtest.h>

namespace rigor {
namespace {

constexpr Duration kPeriod = milliseconds(40);
BenchTime at(int periods) { return BenchTime(0) + kPeriod * periods; }

TEST(FrameSequence, CountsOnOverTheEndOfSixteenBits) {
  FrameSequence s(kPeriod);
  EXPECT_EQ(s.step(65533, at(0)).sequence, 0U);
  EXPECT_EQ(s.step(65534, at(1)).sequence, 1U);
  EXPECT_EQ(s.step(65535, at(2)).sequence, 2U);
  EXPECT_EQ(s.step(1, at(3)).sequence, 3U);
  const auto lost = s.step(3, at(5));
  EXPECT_EQ(lost.sequence, 5U);
  EXPECT_EQ(lost.lost_before, 1U);
}

TEST(FrameSequence, AGapOverTheEndIsAGap) {
  FrameSequence s(kPeriod);
  (void)s.step(65530, at(0));
  const auto step = s.step(4, at(9));
  EXPECT_EQ(step.sequence, 9U);
  EXPECT_EQ(step.lost_before, 8U);
  EXPECT_FALSE(step.from_time);
}

TEST(FrameSequence, AfterARestartTheTimeTells) {
  FrameSequence s(kPeriod);
  (void)s.step(500, at(0));
  s.restart();
  EXPECT_EQ(s.gap(501), 0U);
  const auto step = s.step(1, at(30) + milliseconds(3));
  EXPECT_TRUE(step.from_time);
  EXPECT_EQ(step.sequence, 30U);
  EXPECT_EQ(step.lost_before, 29U);
  EXPECT_EQ(s.step(2, at(31)).sequence, 31U);
}

TEST(FrameSequence, IdsThatBeginAnewUnannouncedAreTakenForARestart) {
  FrameSequence s(kPeriod);
  (void)s.step(2000, at(0));
  EXPECT_TRUE(s.step(1, at(7)).from_time);
  FrameSequence u(kPeriod);
  (void)u.step(70000, at(0));
  EXPECT_TRUE(u.step(5, at(3)).from_time);
}

TEST(FrameSequence, NeverGoesBack) {
  FrameSequence s(kPeriod);
  std::uint64_t last = s.step(100, at(10)).sequence;
  for (const auto& [id, t] :
       {std::pair<std::uint64_t, int>{100, 10}, {99, 9}, {1, 0}, {0, 11}, {65535, 12}}) {
    const auto step = s.step(id, at(t));
    EXPECT_GT(step.sequence, last) << id;
    last = step.sequence;
  }
}

TEST(FrameSequence, LongIdsHaveNoEnd) {
  FrameSequence s(kPeriod);
  (void)s.step(65535, at(0));
  EXPECT_EQ(s.step(65537, at(2)).sequence, 2U);
  EXPECT_EQ(s.step(200000, at(134465)).lost_before, 200000U - 65537U - 1U);
}

}  // namespace
}  // namespace rigor
