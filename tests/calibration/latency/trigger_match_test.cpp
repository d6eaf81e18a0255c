#include "calibration/latency/trigger_match.h"

#include <gtest/gtest.h>

namespace rigor::calibration {
namespace {

using Times = std::vector<std::int64_t>;

TEST(TriggerMatch, ASampleBelongsToTheTriggerBeforeIt) {
  const TriggerMatch m = match_triggers(Times{100, 200, 350, 450}, Times{20, 130, 200, 470});
  ASSERT_EQ(m.pairs.size(), 3u);
  EXPECT_EQ(m.pairs[0].trigger, 0u);
  EXPECT_EQ(m.pairs[0].sample, 1u);
  EXPECT_EQ(m.pairs[1].trigger, 1u);  // at the very instant of the trigger: its own
  EXPECT_EQ(m.pairs[1].sample, 2u);
  EXPECT_EQ(m.pairs[2].trigger, 3u);
  EXPECT_EQ(m.pairs[2].sample, 3u);
  EXPECT_EQ(m.without_sample, 1u);
  EXPECT_EQ(m.without_trigger, 0u);
  EXPECT_EQ(m.minimum_interval_ns, 100);
}

TEST(TriggerMatch, SamplesThatNoTriggerCausedAreCounted) {
  const TriggerMatch m = match_triggers(Times{100, 200}, Times{110, 120, 130, 210, 220});
  EXPECT_EQ(m.pairs.size(), 2u);
  EXPECT_EQ(m.without_trigger, 3u);
}

TEST(TriggerMatch, TheLastTriggersSampleMayComeAfterTheEnd) {
  const TriggerMatch m = match_triggers(Times{100, 200}, Times{110});
  EXPECT_EQ(m.pairs.size(), 1u);
  EXPECT_EQ(m.without_sample, 0u);
}

TEST(TriggerMatch, OfNothingIsNothing) {
  EXPECT_TRUE(match_triggers({}, Times{1}).pairs.empty());
  EXPECT_TRUE(match_triggers(Times{1}, {}).pairs.empty());
  EXPECT_EQ(match_triggers(Times{1}, Times{2}).minimum_interval_ns, 0);
}

}  // namespace
}  // namespace rigor::calibration
