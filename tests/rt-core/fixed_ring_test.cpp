// FixedRing: order, wrap, capacity one, values that can only be moved, and what a place holds once it was
// left.
#include "rt-core/fixed_ring.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <deque>
#include <memory>
#include <random>

namespace rigor {
namespace {

TEST(FixedRing, BehavesAsAQueueOfItsCapacityDoes) {
  constexpr std::size_t kPlaces = 5;
  FixedRing<int, kPlaces> inside;
  FixedRing<int> outside(kPlaces);
  std::deque<int> expected;
  std::mt19937_64 random(7);
  int next = 0;
  for (int step = 0; step < 20000; ++step) {
    ASSERT_EQ(inside.size(), expected.size());
    ASSERT_EQ(outside.size(), expected.size());
    ASSERT_EQ(inside.empty(), expected.empty());
    ASSERT_EQ(inside.full(), expected.size() == kPlaces);
    ASSERT_EQ(outside.full(), expected.size() == kPlaces);
    for (std::size_t i = 0; i < expected.size(); ++i) {
      ASSERT_EQ(inside[i], expected[i]);
      ASSERT_EQ(outside[i], expected[i]);
    }
    if (!expected.empty()) {
      ASSERT_EQ(inside.front(), expected.front());
      ASSERT_EQ(inside.back(), expected.back());
    }
    const std::uint64_t what = random() % 100;
    if (what == 0) {
      inside.clear(), outside.clear(), expected.clear();
    } else if (what < 20) {  // the oldest gives way
      if (expected.size() == kPlaces) expected.pop_front();
      expected.push_back(next);
      EXPECT_EQ(inside.push_newest(next), next);
      EXPECT_EQ(outside.push_newest(next), next);
      ++next;
    } else if (what < 60 && expected.size() < kPlaces) {
      expected.push_back(next);
      EXPECT_EQ(inside.push_back(next), next);
      EXPECT_EQ(outside.push_back(next), next);
      ++next;
    } else if (!expected.empty()) {
      EXPECT_EQ(inside.pop_front(), expected.front());
      EXPECT_EQ(outside.pop_front(), expected.front());
      expected.pop_front();
    }
  }
  EXPECT_EQ(inside.capacity(), kPlaces);
  EXPECT_EQ(outside.capacity(), kPlaces);
}

TEST(FixedRing, OfOnePlaceIsEmptyOrFull) {
  FixedRing<int, 1> ring;
  for (int k = 0; k < 3; ++k) {
    EXPECT_TRUE(ring.empty());
    EXPECT_FALSE(ring.full());
    ring.push_back(k);
    EXPECT_TRUE(ring.full());
    EXPECT_EQ(ring.push_newest(k + 10), k + 10);
    EXPECT_EQ(ring.size(), 1u);
    EXPECT_EQ(ring.pop_front(), k + 10);
  }
}

TEST(FixedRing, TakesValuesThatCanOnlyBeMoved) {
  FixedRing<std::unique_ptr<int>> ring(2);
  ring.push_back(std::make_unique<int>(1));
  ring.push_back(std::make_unique<int>(2));
  EXPECT_EQ(*ring.pop_front(), 1);
  ring.push_back(std::make_unique<int>(3));

  FixedRing<std::unique_ptr<int>> to = std::move(ring);
  EXPECT_TRUE(ring.empty());  // NOLINT(bugprone-use-after-move): that is what is promised
  ASSERT_EQ(to.size(), 2u);
  EXPECT_EQ(*to[0], 2);
  EXPECT_EQ(*to[1], 3);
}

TEST(FixedRing, LetsGoOfWhatItsValuesHoldWhenTheyLeave) {
  struct Kept {
    std::shared_ptr<int> lease;
    // Moved from, a copy stays behind: only a place that is written anew lets it go.
    Kept() = default;
    explicit Kept(std::shared_ptr<int> l) : lease(std::move(l)) {}
    Kept(const Kept&) = default;
    Kept& operator=(const Kept&) = default;
    ~Kept() = default;
  };
  const auto held = std::make_shared<int>(0);
  FixedRing<Kept, 4> ring;
  for (int k = 0; k < 3; ++k) ring.push_back(Kept(held));
  EXPECT_EQ(held.use_count(), 4);
  (void)ring.pop_front();
  EXPECT_EQ(held.use_count(), 3);
  ring.clear();
  EXPECT_EQ(held.use_count(), 1);
  for (int k = 0; k < 6; ++k) ring.push_newest(Kept(held));
  EXPECT_EQ(held.use_count(), 5);
  ring = {};
  EXPECT_EQ(held.use_count(), 1);
}

}  // namespace
}  // namespace rigor
