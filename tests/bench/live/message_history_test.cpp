// What a page that is opened late gets of the time before.
#include "bench/live/message_history.h"

#include <gtest/gtest.h>

namespace rigor::live {
namespace {

Bytes message(std::uint64_t i) { return std::make_shared<const std::string>(std::to_string(i)); }

TEST(MessageHistory, OfALongRunIsBoundedAndCoversAllOfItEvenly) {
  MessageHistory h;
  h.keep(3, MessageHistory::Keep::thinned);
  constexpr std::uint64_t kCount = 1'000'000, kPeriod_ns = 40'000'000;
  for (std::uint64_t i = 0; i < kCount; ++i) h.add(3, i * kPeriod_ns, message(i));
  const auto kept = h.messages(3);
  ASSERT_GE(kept.size(), MessageHistory::kMost / 2);
  ASSERT_LE(kept.size(), MessageHistory::kMost);
  EXPECT_EQ(*kept.front().message, "0");
  EXPECT_EQ(*kept.back().message, std::to_string(kCount - 1)) << "the newest is missing";
  const double even = static_cast<double>(kCount * kPeriod_ns) / static_cast<double>(kept.size());
  for (std::size_t i = 1; i < kept.size(); ++i) {
    const double gap = static_cast<double>(kept[i].time_ns - kept[i - 1].time_ns);
    EXPECT_GT(gap, 0);
    EXPECT_LT(gap, 2.5 * even) << "a hole before message " << *kept[i].message;
  }
}

TEST(MessageHistory, OfAShortRunIsWhole) {
  MessageHistory h;
  h.keep(1, MessageHistory::Keep::thinned);
  for (std::uint64_t i = 0; i < 100; ++i) h.add(1, i * i, message(i));
  EXPECT_EQ(h.messages(1).size(), 100u);
}

TEST(MessageHistory, OfEventsHasTheLastOnes) {
  MessageHistory h;
  h.keep(1, MessageHistory::Keep::newest);
  for (std::uint64_t i = 0; i < 5000; ++i) h.add(1, 7, message(i));  // all of one instant
  const auto kept = h.messages(1);
  ASSERT_EQ(kept.size(), MessageHistory::kMost);
  EXPECT_EQ(*kept.front().message, std::to_string(5000 - MessageHistory::kMost));
  EXPECT_EQ(*kept.back().message, "4999");
}

TEST(MessageHistory, HasNothingOfWhatIsNotKeptAndNothingThatIsLong) {
  MessageHistory h;
  h.add(1, 1, message(1));
  EXPECT_TRUE(h.messages(1).empty());
  EXPECT_FALSE(h.keeps(1));
  h.keep(1, MessageHistory::Keep::thinned);
  h.add(1, 1, std::make_shared<const std::string>(MessageHistory::kLongest + 1, 'x'));
  h.add(1, 2, nullptr);
  EXPECT_TRUE(h.messages(1).empty());
  h.add(1, 3, std::make_shared<const std::string>(MessageHistory::kLongest, 'x'));
  EXPECT_EQ(h.messages(1).size(), 1u);
}

TEST(MessageHistory, OfARunThatIsBegunAnewForgetsTheFirst) {
  MessageHistory h;
  h.keep(1, MessageHistory::Keep::thinned);
  for (std::uint64_t i = 0; i < 3000; ++i) h.add(1, i * 1'000'000'000, message(i));
  h.add(1, 0, message(77));
  h.add(1, 1, message(78));  // no gap is left of the long run
  const auto kept = h.messages(1);
  ASSERT_EQ(kept.size(), 2u);
  EXPECT_EQ(*kept.front().message, "77");
}

}  // namespace
}  // namespace rigor::live
