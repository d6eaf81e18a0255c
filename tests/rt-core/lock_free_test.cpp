// The lock-free types under all executions of a few threads, stale reads included: that nothing goes wrong,
// and that each memory order is needed, by making it weaker. The types are those of production with another
// template argument; the queue within SpscRing comes with atomics and fences of its own, which this file
// replaces.
#include <gtest/gtest.h>

#include <cstdio>
#include <memory>

#include "tests/rt-core/memory_model.h"

// What the queue needs of atomicops.h, in a namespace of our own.
#include <readerwriterqueue/atomicops.h>
namespace modelled {
using rigor::test::Model;
namespace spsc_sema = moodycamel::spsc_sema;  // of a part that is not used
enum memory_order { memory_order_relaxed, memory_order_acquire, memory_order_release, memory_order_sync };
inline void fence(memory_order order, std::source_location where = std::source_location::current()) {
  Model::current().fence(order != memory_order_release, order != memory_order_acquire, where);
}
inline void compiler_fence(memory_order) {}
template <class T>
class weak_atomic {
 public:
  weak_atomic() = default;
  template <class U>
  weak_atomic(U&& value) : value_(word(static_cast<T>(value))) {}
  template <class U>
  const weak_atomic& operator=(U&& value) {
    value_.store(word(static_cast<T>(value)), std::memory_order_relaxed);
    return *this;
  }
  operator T() const { return load(); }
  T load() const {
    const std::uint64_t w = value_.load(std::memory_order_relaxed);
    if constexpr (std::is_pointer_v<T>)
      return reinterpret_cast<T>(w);
    else
      return static_cast<T>(w);
  }

 private:
  static std::uint64_t word(T value) {
    if constexpr (std::is_pointer_v<T>)
      return reinterpret_cast<std::uint64_t>(value);
    else
      return static_cast<std::uint64_t>(value);
  }
  rigor::test::ModelAtomic<std::uint64_t> value_{0};
};
}  // namespace modelled
#define moodycamel modelled
#include "rt-core/spsc_ring.h"
#undef moodycamel

#include "rt-core/pool.h"
#include "rt-core/published.h"
#include "sensor-hal/channel/side_switch.h"

namespace rigor::test {
namespace {

using Scenario = std::function<void(Model&)>;

/// Each order made weaker in turn: acquire and release to relaxed, acq_rel to each of its halves. Those that
/// make no scenario fail are the answer.
std::vector<std::string> unneeded(const std::vector<Scenario>& scenarios) {
  std::map<Site, std::memory_order> sites;
  for (const Scenario& s : scenarios) {
    const Outcome o = Model().explore(s);
    EXPECT_EQ(o.failure, "");
    sites.insert(o.sites.begin(), o.sites.end());
    std::printf("%llu executions\n", static_cast<unsigned long long>(o.executions));
  }
  EXPECT_FALSE(sites.empty());
  std::vector<std::string> all;
  for (const auto& [site, order] : sites) {
    std::vector<std::pair<std::memory_order, const char*>> weaker{{std::memory_order_relaxed, "relaxed"}};
    if (order == std::memory_order_acq_rel)
      weaker = {{std::memory_order_acquire, "acquire"}, {std::memory_order_release, "release"}};
    for (const auto& [to, name] : weaker) {
      std::string failure;
      for (const Scenario& s : scenarios)
        if (failure.empty()) failure = Model().explore(s, {site, to}).failure;
      std::printf("%s %s: %s\n", site.c_str(), name, failure.empty() ? "nothing is seen" : failure.c_str());
      if (failure.empty()) all.push_back(site + " " + name);
    }
  }
  return all;
}

TEST(MemoryModel, FindsARaceThatRelaxedOrdersLeaveOpen) {
  const auto message = [](std::memory_order release, std::memory_order acquire) {
    return Model().explore([=](Model& m) {
      const auto flag = std::make_shared<ModelAtomic<int>>(0);
      const auto data = std::make_shared<ModelData>();
      m.thread([=] { data->write(), flag->store(1, release); });
      m.thread([=] {
        if (flag->load(acquire) == 1) data->read();
      });
    });
  };
  EXPECT_EQ(message(std::memory_order_release, std::memory_order_acquire).failure, "");
  EXPECT_EQ(message(std::memory_order_release, std::memory_order_relaxed).failure, "a read races");
  EXPECT_EQ(message(std::memory_order_relaxed, std::memory_order_acquire).failure, "a read races");
}

/// Store buffering: both threads may read what the other has overwritten. Coherence: none reads backwards.
TEST(MemoryModel, ReadsStaleValuesAndNeverBackwards) {
  int both_stale = 0;
  const auto o = Model().explore([&](Model& m) {
    struct State {
      ModelAtomic<int> x{0}, y{0};
      int a = 1, b = 1;
    };
    const auto s = std::make_shared<State>();
    constexpr auto relaxed = std::memory_order_relaxed;
    m.thread([=] { s->x.store(1, relaxed), s->a = s->y.load(relaxed); });
    m.thread([=, &m] {
      s->y.store(1, relaxed), s->b = s->x.load(relaxed);
      m.check(s->x.load(relaxed) >= s->b, "backwards");
    });
    m.after([=, &both_stale] { both_stale += s->a == 0 && s->b == 0; });
  });
  EXPECT_EQ(o.failure, "");
  EXPECT_GT(both_stale, 0);
}

struct Value {
  std::uint64_t a = 0, b = 0;
};

/// Four values after the first, so that a slot is written again while it may be read. Who is overtaken may
/// get a value that is just about to be published, and then once more the one before.
TEST(LockFree, PublishedValueNeedsEachOfItsOrders) {
  const Scenario scenario = [](Model& m) {
    const auto value = std::make_shared<Published<Value, ModelAtomic>>();
    m.thread([=] {
      for (std::uint64_t k = 1; k <= 4; ++k) value->store({k, k});
    });
    m.thread(
        [=, &m] {
          Value before;
          for (int i = 0; i < 2; ++i) {
            const Value v = value->load();
            m.check(v.a == v.b, "torn");
            m.check(v.a + 1 >= before.a, "an older value after a newer one");
            before = v;
          }
        },
        15);
  };
  EXPECT_EQ(unneeded({scenario}), std::vector<std::string>{});
}

struct Item {
  Item() = default;
  explicit Item(int v) : value(v) {}
  Item(const Item& o) : value(o.value) { o.memory.read(); }
  Item& operator=(const Item& o) {
    o.memory.read(), memory.write();
    value = o.value;
    return *this;
  }
  int value = 0;
  ModelData memory;
};

template <class Push, class Pop>
void transfer(Model& m, const Push& push, const Pop& pop, int count) {
  m.thread([=] {
    int next = 1;
    for (int attempt = 0; attempt < count + 1 && next <= count; ++attempt) next += push(Item(next));
  });
  m.thread([=, &m] {
    int last = 0;
    for (int attempt = 0; attempt < count; ++attempt) {
      Item item;
      if (!pop(item)) continue;
      m.check(item.value == last + 1, "out of order");
      last = item.value;
    }
  });
}

TEST(LockFree, RingNeedsTheFencesOfItsQueue) {
  const Scenario ring = [](Model& m) {
    const auto r = std::make_shared<SpscRing<Item>>(1);
    transfer(
        m, [r](Item&& item) { return r->try_push(std::move(item)); },
        [r](Item& item) { return r->try_pop(item); }, 3);
  };
  const Scenario peek = [](Model& m) {
    const auto r = std::make_shared<SpscRing<Item>>(1);
    transfer(
        m, [r](Item&& item) { return r->try_push(std::move(item)); },
        [r](Item& item) {
          const Item* front = r->peek();
          if (!front) return false;
          item = *front;
          r->drop_front();
          return true;
        },
        3);
  };
  // Two are for what SpscRing does not do: pop without peek, and more than one block.
  EXPECT_EQ(unneeded({ring, peek}).size(), 2);
}

using ModelPool = Pool<ModelData, ModelAtomic>;
using ModelLease = Lease<ModelData, ModelAtomic>;

/// Who reads a slot and leaves it, and who takes it next to write.
void take_again(Model& m) {
  struct State {
    ModelPool pool{1};
    ModelLease mine, theirs;
  };
  const auto s = std::make_shared<State>();
  auto slot = s->pool.try_acquire();
  slot->write();
  s->mine = std::move(slot);
  s->theirs = s->mine;
  m.thread([=] {
    s->mine->read();
    s->mine.reset();
    if (auto again = s->pool.try_acquire()) again->write();
  });
  m.thread([=] {
    const ModelLease copy = s->theirs;
    s->theirs.reset();
    copy->read();
  });
}
/// Who is left alone with a slot and writes again.
void take_back(Model& m) {
  struct State {
    ModelPool pool{1};
    ModelLease mine, theirs;
  };
  const auto s = std::make_shared<State>();
  s->mine = s->pool.try_acquire();
  s->theirs = s->mine;
  m.thread([=] {
    if (auto again = s->mine.take_back()) again->write();
  });
  m.thread([=] {
    s->theirs->read();
    s->theirs.reset();
  });
}
/// The pool goes while others read; who comes last frees the memory.
void destroy(Model& m, bool hold) {
  struct State {
    std::unique_ptr<ModelPool> pool = std::make_unique<ModelPool>(2);
    ModelLease one, two;
    SlotHold<ModelData, ModelAtomic> held;
  };
  const auto s = std::make_shared<State>();
  s->one = s->pool->try_acquire();
  s->two = hold ? s->one : ModelLease(s->pool->try_acquire());
  if (hold) s->held = s->one.hold();
  m.thread([=] { s->pool.reset(); });
  m.thread([=] {
    s->one->read();
    s->one.reset();
  });
  m.thread([=] {
    s->two->read();
    s->two.reset();
    s->held = {};
  });
}

TEST(LockFree, PoolNeedsEachOfItsOrders) {
  EXPECT_EQ(unneeded({take_again, take_back, [](Model& m) { destroy(m, false); },
                      [](Model& m) { destroy(m, true); }}),
            std::vector<std::string>{});
}

/// What was prepared before a switch is there in the cycle that carries it out.
TEST(LockFree, SideSwitchNeedsEachOfItsOrders) {
  const Scenario scenario = [](Model& m) {
    struct State {
      SideSwitch<ModelAtomic> pair;
      ModelData prepared;
    };
    const auto s = std::make_shared<State>();
    s->pair.start(PairSide::real);
    m.thread([=] {
      s->prepared.write();
      s->pair.want(PairSide::simulated);
    });
    m.thread([=] {
      for (int cycle = 0; cycle < 2; ++cycle)
        if (s->pair.advance()) s->prepared.read();
    });
    m.thread([=, &m] {
      m.check(s->pair.count() <= 1, "switched more often than it was asked for");
      (void)s->pair.active();
    });
    m.after([=, &m] { m.check(s->pair.count() <= 1, "switched twice"); });
  };
  EXPECT_EQ(unneeded({scenario}), std::vector<std::string>{});
}

}  // namespace
}  // namespace rigor::test
