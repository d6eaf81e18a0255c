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

/// Waits for another thread: where both run, the answer comes within a few tries, and a yield to the rest of
/// a busy machine would cost milliseconds.
class Backoff {
 public:
  void operator()() {
    if (++tries_ % 256 == 0) std::this_thread::yield();
  }

 private:
  unsigned tries_ = 0;
};

TEST(Pool, GivesOutEverySlotOnceAndThenNone) {
  Pool<int> pool(3);
  std::vector<Lease<int>> held;
  for (int i = 0; i < 3; ++i) {
    WritableSlot<int> slot = pool.try_acquire();
    ASSERT_TRUE(slot);
    *slot = i;
    held.push_back(std::move(slot));
  }
  EXPECT_FALSE(pool.try_acquire());
  EXPECT_EQ(pool.in_use(), 3u);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(*held[static_cast<std::size_t>(i)], i);
  held[1].reset();
  WritableSlot<int> again = pool.try_acquire();
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

TEST(Pool, WithoutSlotsGivesNone) {
  Pool<int> pool(0);
  EXPECT_FALSE(pool.try_acquire());
  EXPECT_EQ(pool.in_use(), 0u);
}

TEST(WritableSlot, IsFreeAgainWhenItIsNotPublished) {
  Pool<int> pool(2);
  WritableSlot<int> a = pool.try_acquire(), b = pool.try_acquire();
  EXPECT_FALSE(pool.try_acquire());
  a = std::move(b);
  EXPECT_FALSE(b);  // NOLINT: moved from, and empty by contract
  EXPECT_EQ(pool.in_use(), 1u);
  a.reset();
  EXPECT_EQ(pool.in_use(), 0u);
}

TEST(Lease, TheOnlyHolderTakesTheSlotBack) {
  Pool<int> pool(1);
  WritableSlot<int> slot = pool.try_acquire();
  *slot = 1;
  Lease<int> lease = std::move(slot);
  EXPECT_FALSE(slot);  // NOLINT: published
  slot = lease.take_back();
  ASSERT_TRUE(slot);
  EXPECT_FALSE(lease);
  EXPECT_EQ(*slot, 1);
  *slot = 2;
  lease = std::move(slot);
  EXPECT_EQ(*lease, 2);
  EXPECT_EQ(pool.in_use(), 1u);
  EXPECT_FALSE(Lease<int>().take_back());
}

TEST(Lease, ASecondHolderKeepsTheSlotFromBeingTakenBack) {
  Pool<int> pool(1);
  Lease<int> lease = pool.try_acquire();
  Lease<int> second = lease;
  EXPECT_FALSE(lease.take_back());
  ASSERT_TRUE(lease) << "it is as before";
  EXPECT_TRUE(lease.same_as(second));
  second.reset();
  EXPECT_TRUE(lease.take_back());
}

TEST(SlotHold, OccupiesASlotThatItsOnlyHolderMayWrite) {
  Pool<int> pool(1);
  Lease<int> lease = pool.try_acquire();
  {
    const SlotHold<int> hold = lease.hold();
    EXPECT_TRUE(lease.take_back());
    lease.reset();
    EXPECT_EQ(pool.in_use(), 1u);
    EXPECT_FALSE(pool.try_acquire()) << "it is held";
  }
  EXPECT_TRUE(pool.try_acquire());
}

/// Counts those that live.
struct Counted {
  static inline std::atomic<int> alive{0};
  Counted() { ++alive; }
  ~Counted() { --alive; }
  Counted(const Counted&) = delete;
  std::uint64_t value = 0;
};

TEST(Pool, IsKeptByItsLeasesSlotsAndHolds) {
  Lease<Counted> lease, copy;
  WritableSlot<Counted> slot;
  SlotHold<Counted> hold;
  {
    Pool<Counted> pool(5);
    slot = pool.try_acquire();
    slot->value = 7;
    lease = copy = std::move(slot);
    slot = pool.try_acquire();
    hold = Lease<Counted>(pool.try_acquire()).hold();
    (void)Lease<Counted>(pool.try_acquire());
    EXPECT_EQ(Counted::alive, 5);
  }
  EXPECT_EQ(Counted::alive, 5);
  slot->value = 8;  // AddressSanitizer: the memory is still there
  hold = {};
  slot.reset();
  copy.reset();
  EXPECT_EQ(Counted::alive, 5);
  EXPECT_EQ(lease->value, 7u);
  slot = lease.take_back();
  ASSERT_TRUE(slot) << "also without its pool";
  slot.reset();
  EXPECT_EQ(Counted::alive, 0);
  { Pool<Counted> unused(3); }
  EXPECT_EQ(Counted::alive, 0);
}

// One thread reads and drops its lease; the other writes as soon as it is the only holder.
TEST(Lease, IsTakenBackAfterAllReadsOfTheOther) {
  Pool<Counted> pool(1);
  SpscRing<Lease<Counted>> ring(2);
  std::atomic<std::uint64_t> wrong{0};
  const std::uint64_t rounds = kRounds / 10;
  std::thread reader([&] {
    Backoff wait;
    Lease<Counted> lease;
    for (std::uint64_t i = 1; i <= rounds; lease.reset(), ++i) {
      while (!ring.try_pop(lease)) wait();
      wrong += lease->value != i;
    }
  });
  Backoff wait;
  Lease<Counted> mine = pool.try_acquire();
  for (std::uint64_t i = 1; i <= rounds; ++i) {
    WritableSlot<Counted> slot;
    while (!(slot = mine.take_back())) wait();
    slot->value = i;
    mine = std::move(slot);
    (void)ring.try_push(mine);
  }
  reader.join();
  EXPECT_EQ(wrong, 0u);
}

// Two threads read and drop leases while the pool is destroyed: whoever is last frees the memory, once, after
// all reads.
TEST(Pool, DiesOnceWhileTwoThreadsDropItsLeases) {
  constexpr std::size_t kSlots = 4;
  for (int round = 0; round < kRounds / 200; ++round) {
    auto pool = std::make_unique<Pool<Counted>>(kSlots);
    std::vector<Lease<Counted>> first, second;
    for (std::size_t i = 0; i < kSlots; ++i) {
      WritableSlot<Counted> slot = pool->try_acquire();
      slot->value = i;
      first.emplace_back(std::move(slot));
    }
    second = first;
    std::atomic<int> ready{0};
    std::atomic<bool> wrong{false};
    const auto drop = [&](std::vector<Lease<Counted>> leases) {
      Backoff wait;
      ++ready;
      while (ready < 3) wait();
      for (std::size_t i = 0; i < kSlots; ++i) {
        const Lease<Counted> copy = leases[i];
        leases[i].reset();
        if (copy->value != i) wrong = true;
      }
    };
    std::thread a(drop, std::move(first)), b(drop, std::move(second));
    Backoff wait;
    ++ready;
    while (ready < 3) wait();
    pool.reset();
    a.join();
    b.join();
    ASSERT_FALSE(wrong);
    ASSERT_EQ(Counted::alive, 0) << "round " << round;
  }
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
    Backoff wait;
    Lease<Block> lease;
    for (;;) {
      const bool last = end.load(std::memory_order_acquire);
      if (ring.try_pop(lease)) {
        for (const std::uint64_t v : lease->value) torn += v != lease->value[0];
        lease.reset();
      } else if (last) {
        return;
      } else {
        wait();
      }
    }
  };
  std::thread a([&] { read(to_a); }), b([&] { read(to_b); });
  Backoff wait;
  std::uint64_t sent = 0;
  while (sent < kRounds) {
    WritableSlot<Block> slot = pool.try_acquire();
    if (!slot) {
      wait();
      continue;
    }
    for (std::uint64_t& v : slot->value) v = sent;
    Lease<Block> lease = std::move(slot);
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
    Backoff wait;
    for (std::uint64_t i = 0; i < kCount;) {
      if (ring.try_push(i))
        ++i;
      else
        wait();
    }
  });
  Backoff wait;
  std::uint64_t expected = 0, wrong = 0;
  while (expected < kCount) {
    std::uint64_t value = 0;
    if (!ring.try_pop(value)) {
      wait();
      continue;
    }
    wrong += value != expected++;
  }
  producer.join();
  EXPECT_EQ(wrong, 0u);
}

}  // namespace
}  // namespace rigor
