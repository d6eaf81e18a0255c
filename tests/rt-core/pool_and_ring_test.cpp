#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "rt-core/pool.h"
#include "rt-core/sanitizers.h"
#include "rt-core/spsc_ring.h"

namespace rigor {
namespace {

// Under ThreadSanitizer each step costs some ten times more.
#if defined(RIGOR_THREAD_SANITIZER)
constexpr int kRounds = 20'000;
#else
constexpr int kRounds = 200'000;
#endif

TEST(Pool, GivesOutEverySlotOnceAndThenNone) {
  Pool<int> pool(3);
  std::vector<Lease<int>> held;
  for (int i = 0; i < 3; ++i) {
    held.push_back(pool.try_acquire());
    ASSERT_TRUE(held.back());
    held.back().edit() = i;
  }
  EXPECT_FALSE(pool.try_acquire());
  EXPECT_EQ(pool.in_use(), 3u);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(*held[static_cast<std::size_t>(i)], i);
  held[1].reset();
  Lease<int> again = pool.try_acquire();
  ASSERT_TRUE(again);
  EXPECT_EQ(*again, 1) << "the slot that came free";
  EXPECT_FALSE(pool.try_acquire());
}

TEST(Lease, TheLastCopyFreesTheSlot) {
  Pool<int> pool(1);
  Lease<int> a = pool.try_acquire();
  Lease<int> b = a;
  Lease<int> c = std::move(a);
  EXPECT_FALSE(a);  // NOLINT: moved from, and empty by contract
  EXPECT_TRUE(b.same_as(c));
  b = static_cast<const Lease<int>&>(b);  // to itself, on purpose
  EXPECT_TRUE(b);
  b.reset();
  EXPECT_EQ(pool.in_use(), 1u);
  c = Lease<int>();
  EXPECT_EQ(pool.in_use(), 0u);
}

// The producer writes plain memory in a slot, two threads read it through copies of the lease. A pool that
// takes a slot back without acquire, or frees it without release, is a data race here; ThreadSanitizer says
// so, and on weakly ordered machines the values tear.
TEST(Pool, NobodySeesASlotBeforeItsLastReaderHasLeft) {
  struct Block {
    std::uint64_t value[8];
  };
  Pool<Block> pool(4);
  SpscRing<Lease<Block>> to_a(8), to_b(8);
  std::atomic<std::uint64_t> torn{0};
  std::atomic<bool> end{false};
  const auto read = [&](SpscRing<Lease<Block>>& ring) {
    Lease<Block> lease;
    for (;;) {
      const bool last = end.load(std::memory_order_acquire);
      if (ring.try_pop(lease)) {
        for (const std::uint64_t v : lease->value) torn += v != lease->value[0];
        lease.reset();
      } else if (last) {
        return;
      } else {
        std::this_thread::yield();
      }
    }
  };
  std::thread a([&] { read(to_a); }), b([&] { read(to_b); });
  std::uint64_t sent = 0;
  while (sent < kRounds) {
    Lease<Block> lease = pool.try_acquire();
    if (!lease) {
      std::this_thread::yield();
      continue;
    }
    for (std::uint64_t& v : lease.edit().value) v = sent;
    (void)to_a.try_push(lease);
    (void)to_b.try_push(std::move(lease));
    ++sent;
  }
  end.store(true, std::memory_order_release);
  a.join();
  b.join();
  EXPECT_EQ(torn, 0u);
  EXPECT_EQ(pool.in_use(), 0u);
}

TEST(SpscRing, HoldsAtLeastItsPlacesAndLeavesTheValueWhenFull) {
  SpscRing<std::unique_ptr<int>> ring(5);
  int pushed = 0;
  for (;; ++pushed) {
    auto value = std::make_unique<int>(pushed);
    if (!ring.try_push(std::move(value))) {
      EXPECT_TRUE(value);  // NOLINT: untouched by contract
      break;
    }
  }
  EXPECT_GE(pushed, 5);
  ASSERT_NE(ring.peek(), nullptr);
  EXPECT_EQ(**ring.peek(), 0);
  ring.drop_front();
  for (int i = 1; i < pushed; ++i) {
    std::unique_ptr<int> value;
    ASSERT_TRUE(ring.try_pop(value));
    EXPECT_EQ(*value, i);
  }
  std::unique_ptr<int> value;
  EXPECT_FALSE(ring.try_pop(value));
  EXPECT_EQ(ring.peek(), nullptr);
}

TEST(SpscRing, PassesEverythingOnInOrderBetweenTwoThreads) {
  SpscRing<std::uint64_t> ring(64);
  constexpr std::uint64_t kCount = kRounds;
  std::thread producer([&] {
    for (std::uint64_t i = 0; i < kCount;) {
      if (ring.try_push(i))
        ++i;
      else
        std::this_thread::yield();
    }
  });
  std::uint64_t expected = 0, wrong = 0;
  while (expected < kCount) {
    std::uint64_t value = 0;
    if (!ring.try_pop(value)) {
      std::this_thread::yield();
      continue;
    }
    wrong += value != expected++;
  }
  producer.join();
  EXPECT_EQ(wrong, 0u);
}

}  // namespace
}  // namespace rigor
