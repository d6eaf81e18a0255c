// The executive against the clock. A virtual machine may be stalled at any time, so these tests judge
// accounting alone; how well wake-ups are met is measured by benches/bench_loop.cpp.
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <thread>
#include <vector>

#include "rt-core/executive.h"

namespace rigor {
namespace {

void busy(Duration d) {
  const std::int64_t end = monotonic_now().ns() + d.ns();
  while (monotonic_now().ns() < end) {
  }
}

ExecutiveConfig wall_config(std::uint64_t cycles, OverrunPolicy policy) {
  ExecutiveConfig c;
  c.cycles = cycles;
  c.period = milliseconds(2);
  c.on_overrun = policy;
  c.realtime.lock_memory = false;
  c.realtime.hold_dma_latency = false;
  return c;
}

struct Seen {
  std::uint64_t index;
  std::int64_t t, woke;
};

/// Runs a loop whose step is busy for `busy_for` in the cycles `long_cycles`.
RunSummary run(const ExecutiveConfig& config, std::vector<std::uint64_t> long_cycles, Duration busy_for,
               std::vector<Seen>* seen, BenchTime* t0_out = nullptr) {
  Executive loop(config);
  seen->reserve(config.cycles + 1);
  EXPECT_TRUE(loop.add_step({.name = "work"}, [&](const CycleContext& c) noexcept {
    seen->push_back({c.index, c.t.ns(), monotonic_now().ns()});
    for (const std::uint64_t k : long_cycles)
      if (k == c.index) busy(busy_for);
  }));
  EXPECT_TRUE(loop.arm());
  const BenchTime t0 = bench_now() + milliseconds(150);
  if (t0_out) *t0_out = t0;
  const auto s = loop.run({}, t0);
  EXPECT_TRUE(s) << s.error().text();
  EXPECT_TRUE(loop.disarm());
  return *s;
}

TEST(ExecutiveWall, SkipStaysOnTheGridAndCountsExactly) {
  std::vector<Seen> seen;
  BenchTime t0;
  const RunSummary s = run(wall_config(200, OverrunPolicy::skip), {50, 100}, microseconds(4'500), &seen, &t0);
  EXPECT_EQ(s.reason, StopReason::finished);
  EXPECT_EQ(s.cycles_run, seen.size());
  EXPECT_EQ(s.cycles_run + s.cycles_skipped, 200u);
  EXPECT_GE(s.overruns, 2u);
  EXPECT_GE(s.cycles_skipped, 4u);  // 4.5 ms in a grid of 2 ms: two each
  std::uint64_t gaps = 0, next = 0;
  for (const Seen& c : seen) {
    EXPECT_EQ(c.t, t0.ns() + static_cast<std::int64_t>(c.index) * 2'000'000);  // phase is kept for ever
    EXPECT_GE(c.woke, c.t);
    EXPECT_GE(c.index, next);
    gaps += c.index - next;
    next = c.index + 1;
  }
  gaps += 200 - next;
  EXPECT_EQ(gaps, s.cycles_skipped);
  std::uint64_t skipped_by_misses = 0;
  for (const Miss& m : s.misses.misses) skipped_by_misses += m.skipped;
  EXPECT_EQ(skipped_by_misses, s.cycles_skipped);
  EXPECT_EQ(s.misses.dropped, 0u);
}

TEST(ExecutiveWall, LogRunsEveryCycleAndCatchesUp) {
  std::vector<Seen> seen;
  BenchTime t0;
  const RunSummary s = run(wall_config(200, OverrunPolicy::log), {50}, microseconds(7'000), &seen, &t0);
  EXPECT_EQ(s.cycles_run, 200u);
  EXPECT_EQ(s.cycles_skipped, 0u);
  EXPECT_GE(s.overruns, 1u);
  ASSERT_EQ(seen.size(), 200u);
  for (std::uint64_t k = 0; k < 200; ++k) {
    EXPECT_EQ(seen[k].index, k);
    EXPECT_EQ(seen[k].t, t0.ns() + static_cast<std::int64_t>(k) * 2'000'000);
  }
  // 7 ms in cycle 50: cycles 51 and 52 follow after their points and not before.
  EXPECT_GE(seen[51].woke, seen[51].t);
  EXPECT_GE(seen[60].woke, seen[60].t);
}

TEST(ExecutiveWall, AbortStopsAfterTheCycleThatOverranAndTellsTheHeartbeat) {
  Heartbeat heartbeat;
  ExecutiveConfig c = wall_config(200, OverrunPolicy::abort);
  c.heartbeat = &heartbeat;
  std::vector<Seen> seen;
  const RunSummary s = run(c, {20}, milliseconds(3), &seen);
  EXPECT_EQ(s.reason, StopReason::overrun);
  EXPECT_LE(s.cycles_run, 21u);  // earlier when the host stalls
  EXPECT_EQ(s.cycles_run, seen.size());
  EXPECT_EQ(s.overruns, 1u);
  EXPECT_EQ(heartbeat.stop_reason(), StopReason::overrun);
  EXPECT_TRUE(heartbeat.expired(monotonic_now(), seconds(100)));
}

TEST(ExecutiveWall, SpinNeverWakesBeforeTheGridPoint) {
  ExecutiveConfig c = wall_config(500, OverrunPolicy::skip);
  c.spin = microseconds(300);
  std::vector<Seen> seen;
  const RunSummary s = run(c, {}, Duration(0), &seen);
  EXPECT_EQ(s.wake_error.count(), s.cycles_run);
  EXPECT_EQ(s.wake_error.below_zero(), 0u);
}

TEST(ExecutiveWall, RefusesAStartThatHasPassed) {
  Executive loop(wall_config(5, OverrunPolicy::skip));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, bench_now() - milliseconds(1));
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  ASSERT_TRUE(loop.run({}, bench_now() + milliseconds(150))) << "and can be asked again";
}

TEST(ExecutiveWall, BeginIsAskedForTheStartWhenTheThreadIsSetUp) {
  std::vector<std::int64_t> cycles;
  cycles.reserve(10);
  Executive loop(wall_config(10, OverrunPolicy::skip));
  ASSERT_TRUE(
      loop.add_step({.name = "work"}, [&](const CycleContext& c) noexcept { cycles.push_back(c.t.ns()); }));
  ASSERT_TRUE(loop.arm());
  int asked = 0;
  std::size_t set_up = 0;
  BenchTime t0;
  const std::thread::id here = std::this_thread::get_id();
  const auto s = loop.run({}, [&]() -> Result<BenchTime> {
    ++asked;
    EXPECT_EQ(std::this_thread::get_id(), here);
    set_up = loop.settings().size();
    std::this_thread::sleep_for(std::chrono::milliseconds(100));  // slow, and no cycle is lost by it
    return t0 = bench_now() + milliseconds(50);
  });
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(asked, 1);
  EXPECT_GT(set_up, 0u) << "asked before the thread had asked for its priority";
  EXPECT_EQ(set_up, s->settings.size()) << "and what comes after it is not the thread's setup";
  EXPECT_EQ(s->t0, t0);
  ASSERT_FALSE(cycles.empty());
  EXPECT_EQ((BenchTime(cycles.front()) - t0).ns() % milliseconds(2).ns(), 0);
}

TEST(ExecutiveWall, AStartThatHasPassedMeanwhileCostsTheCyclesBefore) {
  std::vector<Seen> seen;
  seen.reserve(50);
  Executive loop(wall_config(50, OverrunPolicy::skip));
  ASSERT_TRUE(loop.add_step({.name = "work"}, [&](const CycleContext& c) noexcept {
    seen.push_back({c.index, c.t.ns(), monotonic_now().ns()});
  }));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, []() -> Result<BenchTime> { return bench_now() - milliseconds(11); });
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(s->reason, StopReason::finished);
  ASSERT_FALSE(seen.empty());
  EXPECT_GE(seen.front().index, 5u) << "the cycles of 11 ms in a grid of 2 ms are over";
  EXPECT_GE(s->cycles_skipped, 5u);
  EXPECT_EQ(s->cycles_run + s->cycles_skipped, 50u);
  ASSERT_FALSE(s->misses.misses.empty());
  EXPECT_EQ(s->misses.misses.front().skipped, seen.front().index);
}

TEST(ExecutiveWall, ABeginThatFailsRunsNoCycle) {
  Heartbeat heartbeat;
  ExecutiveConfig c = wall_config(5, OverrunPolicy::skip);
  c.heartbeat = &heartbeat;
  Executive loop(c);
  ASSERT_TRUE(loop.arm());
  const auto s =
      loop.run({}, []() -> Result<BenchTime> { return fail(ErrorCode::unavailable, "left", "went away"); });
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::unavailable);
  EXPECT_EQ(heartbeat.stop_reason(), StopReason::failed);
  EXPECT_EQ(loop.counters().run.load(), 0u);
  EXPECT_TRUE(loop.run({}, bench_now() + milliseconds(150))) << "and can be asked again";
}

TEST(ExecutiveWall, SigintStopsALoopWithALongPeriodSoon) {
  StopSource stop;
  const SignalStop signals(stop);
  ExecutiveConfig c = wall_config(0, OverrunPolicy::skip);
  c.period = seconds(3600);  // a loop that waited for its next cycle would not return within the test's time
  Executive loop(c);
  ASSERT_TRUE(loop.arm());
  std::thread interrupter([] {
    std::this_thread::sleep_for(std::chrono::milliseconds(400));  // the first cycle has run by then
    kill(getpid(), SIGINT);
  });
  const auto s = loop.run(stop.token(), bench_now() + milliseconds(150));
  interrupter.join();
  EXPECT_EQ(s->reason, StopReason::signal);
  EXPECT_EQ(s->cycles_run, 1u);
}

// What a sink's I/O thread does, here with a flag for a device: it makes safe when the loop hangs, without
// any help of the loop.
TEST(ExecutiveWall, ASinksThreadMakesSafeWhileTheLoopHangs) {
  Heartbeat heartbeat;
  std::atomic<bool> end{false}, release{false};
  std::atomic<int> made_safe{0};
  std::atomic<std::int64_t> safe_at{0};
  std::thread sink([&] {
    while (!end) {
      if (heartbeat.check(monotonic_now(), milliseconds(30)) == LoopPulse::silent && made_safe == 0) {
        ++made_safe;
        safe_at = monotonic_now().ns();
        release = true;  // the hanging step may go on
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  });
  ExecutiveConfig c = wall_config(100, OverrunPolicy::skip);
  c.realtime = RealtimeConfig::none();
  c.heartbeat = &heartbeat;
  Executive loop(c);
  std::int64_t hung_at = 0;
  ASSERT_TRUE(loop.add_step({.name = "hangs"}, [&](const CycleContext& k) noexcept {
    if (k.index < 50 || hung_at != 0) return;
    hung_at = monotonic_now().ns();
    while (!release && monotonic_now().ns() < hung_at + 5'000'000'000) {
    }
  }));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, bench_now() + milliseconds(150));
  end = true;
  sink.join();
  ASSERT_TRUE(s);
  EXPECT_EQ(made_safe, 1);
  EXPECT_GE(safe_at - hung_at, 25'000'000);
  EXPECT_LT(safe_at - hung_at, 4'900'000'000) << "only when the loop came back";
  EXPECT_GT(s->cycles_skipped, 10u);
}

TEST(ExecutiveWall, CountersAreThereWhileItRuns) {
  Executive loop(wall_config(100, OverrunPolicy::skip));
  ASSERT_TRUE(loop.arm());
  std::thread watcher([&] {
    while (loop.counters().run.load() < 10) std::this_thread::yield();
  });
  const auto s = loop.run({}, bench_now() + milliseconds(150));
  watcher.join();
  EXPECT_EQ(loop.counters().run.load(), s->cycles_run);
  EXPECT_EQ(loop.counters().cycle.load(), 100u);
}

}  // namespace
}  // namespace rigor
