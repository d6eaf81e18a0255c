// The executive without a clock: lifecycle, order, rates, virtual time.
#include "rt-core/executive.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <vector>

namespace rigor {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

const auto kNothing = [](const CycleContext&) noexcept {};

ExecutiveConfig virtual_config(std::uint64_t cycles) {
  ExecutiveConfig c;
  c.clock = RunClock::virtual_time;
  c.cycles = cycles;
  return c;
}

TEST(Executive, OrdersStepsByTheDataFlowAndOtherwiseByTheirAddition) {
  Executive loop(virtual_config(1));
  ASSERT_TRUE(loop.add_step({.name = "app", .after = {"left", "right"}}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "right"}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "commands", .after = {"app"}}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "left"}, kNothing));
  ASSERT_TRUE(loop.arm());
  EXPECT_THAT(loop.order(), ElementsAre("right", "left", "app", "commands"));
}

TEST(Executive, NamesTheStepsOfACircle) {
  Executive loop(virtual_config(1));
  ASSERT_TRUE(loop.add_step({.name = "outside", .after = {"a"}}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "a", .after = {"c"}}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "b", .after = {"a"}}, kNothing));
  ASSERT_TRUE(loop.add_step({.name = "c", .after = {"b"}}, kNothing));
  const Status s = loop.arm();
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_THAT(s.error().message, HasSubstr("`a` after `c` after `b` after `a`"));
  EXPECT_EQ(loop.state(), Executive::State::configuring);
}

TEST(Executive, RefusesBadSteps) {
  Executive loop(virtual_config(1));
  EXPECT_EQ(loop.add_step({.name = ""}, kNothing).error().code, ErrorCode::bad_input);
  EXPECT_EQ(loop.add_step({.name = "x", .divisor = 0}, kNothing).error().code, ErrorCode::bad_input);
  EXPECT_EQ(loop.add_step({.name = "x", .divisor = 2, .phase = 2}, kNothing).error().code,
            ErrorCode::bad_input);
  ASSERT_TRUE(loop.add_step({.name = "x"}, kNothing));
  EXPECT_EQ(loop.add_step({.name = "x"}, kNothing).error().code, ErrorCode::bad_input);
  ASSERT_TRUE(loop.add_step({.name = "y", .after = {"z"}}, kNothing));
  const Status s = loop.arm();
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().message, HasSubstr("`z`"));
}

TEST(Executive, RefusesBadPeriods) {
  for (const Duration bad : {Duration(0), milliseconds(-1), seconds(100'000)}) {
    ExecutiveConfig c = virtual_config(1);
    c.period = bad;
    Executive loop(c);
    EXPECT_EQ(loop.arm().error().code, ErrorCode::bad_input);
  }
}

TEST(Executive, EveryIllegalCallSaysWrongStateAndChangesNothing) {
  Executive loop(virtual_config(1));
  EXPECT_EQ(loop.run({}, BenchTime(0)).error().code, ErrorCode::wrong_state);
  EXPECT_EQ(loop.disarm().error().code, ErrorCode::wrong_state);
  ErrorCode during_run = ErrorCode::internal, add_during_run = ErrorCode::internal,
            arm_during_run = ErrorCode::internal, disarm_during_run = ErrorCode::internal;
  ASSERT_TRUE(loop.add_step({.name = "x"}, [&](const CycleContext&) noexcept {
    during_run = loop.run({}, BenchTime(0)).error().code;
    add_during_run = loop.add_step({.name = "y"}, kNothing).error().code;
    arm_during_run = loop.arm().error().code;
    disarm_during_run = loop.disarm().error().code;
  }));
  ASSERT_TRUE(loop.arm());
  EXPECT_EQ(loop.arm().error().code, ErrorCode::wrong_state);
  EXPECT_EQ(loop.add_step({.name = "z"}, kNothing).error().code, ErrorCode::wrong_state);
  ASSERT_TRUE(loop.run({}, BenchTime(0)));
  EXPECT_EQ(during_run, ErrorCode::wrong_state);
  EXPECT_EQ(add_during_run, ErrorCode::wrong_state);
  EXPECT_EQ(arm_during_run, ErrorCode::wrong_state);
  EXPECT_EQ(disarm_during_run, ErrorCode::wrong_state);
  ASSERT_TRUE(loop.disarm());
  EXPECT_EQ(loop.run({}, BenchTime(0)).error().code, ErrorCode::wrong_state);
  ASSERT_TRUE(loop.add_step({.name = "y"}, kNothing));
  ASSERT_TRUE(loop.arm());
  EXPECT_THAT(loop.order(), ElementsAre("x", "y"));
}

TEST(Executive, RatesAreDivisorsWithAPhase) {
  Executive loop(virtual_config(12));
  std::vector<std::uint64_t> third, all;
  ASSERT_TRUE(loop.add_step({.name = "third", .divisor = 3, .phase = 2},
                            [&](const CycleContext& c) noexcept { third.push_back(c.index); }));
  ASSERT_TRUE(
      loop.add_step({.name = "all"}, [&](const CycleContext& c) noexcept { all.push_back(c.index); }));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, BenchTime(0));
  ASSERT_TRUE(s);
  EXPECT_THAT(third, ElementsAre(2, 5, 8, 11));
  EXPECT_EQ(all.size(), 12u);
  EXPECT_EQ(s->steps[0].runs, 4u);
  EXPECT_EQ(s->steps[1].runs, 12u);
}

TEST(Executive, VirtualTimeFollowsTheGridAndLetsSourcesCompleteFirst) {
  struct Hooks : ExecutiveHooks {
    void before_cycle(BenchTime t) override { seen.push_back(t.ns()); }
    void cycle_begin(const CycleContext& c) noexcept override { begun += c.t.ns() == seen.back(); }
    void cycle_end(const CycleContext&) noexcept override { ++ended; }
    std::vector<std::int64_t> seen;
    int begun = 0, ended = 0;
  } hooks;
  Heartbeat heartbeat;
  ExecutiveConfig c = virtual_config(4);
  c.hooks = &hooks;
  c.heartbeat = &heartbeat;
  Executive loop(c);
  ASSERT_TRUE(loop.add_step({.name = "x"}, [&](const CycleContext& k) noexcept {
    EXPECT_TRUE(k.virtual_time);
    EXPECT_EQ((k.t_next - k.t), milliseconds(1));
  }));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, BenchTime(7));
  ASSERT_TRUE(s);
  EXPECT_EQ(s->reason, StopReason::finished);
  EXPECT_EQ(s->cycles_run, 4u);
  EXPECT_EQ(s->cycles_skipped, 0u);
  EXPECT_THAT(hooks.seen, ElementsAre(7, 1'000'007, 2'000'007, 3'000'007));
  EXPECT_EQ(hooks.begun, 4);
  EXPECT_EQ(hooks.ended, 4);
  EXPECT_EQ(heartbeat.beats(), 4u);
  EXPECT_EQ(heartbeat.check(monotonic_now(), milliseconds(1)), LoopPulse::stopped);
  // A second run after the same arm counts from zero.
  const auto again = loop.run({}, BenchTime(0));
  ASSERT_TRUE(again);
  EXPECT_EQ(again->cycles_run, 4u);
  EXPECT_EQ(again->steps[0].runs, 4u);
}

TEST(Executive, RunsAtAnyRateWithoutDrift) {
  for (const Period period : {Period::of_rate(30), Period::of_rate(60000, 1001), Period::of_rate(960)}) {
    ExecutiveConfig c = virtual_config(cycles_in(seconds(5), period));
    c.period = period;
    EXPECT_EQ(c.cycles, static_cast<std::uint64_t>(std::ceil(5 * period.hz()))) << rate_text(period);
    Executive loop(c);
    ASSERT_TRUE(loop.add_step({.name = "x"}, [&](const CycleContext& k) noexcept {
      const auto index = static_cast<std::int64_t>(k.index);
      EXPECT_EQ(k.t, BenchTime(7) + period * index);
      EXPECT_EQ(k.t_next, BenchTime(7) + period * (index + 1));
    }));
    ASSERT_TRUE(loop.arm());
    const auto s = loop.run({}, BenchTime(7));
    ASSERT_TRUE(s);
    EXPECT_EQ(s->cycles_run, c.cycles);
  }
}

TEST(Executive, StopsForTheTokenAndForAFailedStep) {
  StopSource stop;
  Executive loop(virtual_config(0));
  bool by_token = true;
  ASSERT_TRUE(loop.add_step({.name = "x"}, [&](const CycleContext& c) noexcept {
    if (c.index == 9) by_token ? (void)stop.request() : loop.fail_run();
  }));
  ASSERT_TRUE(loop.arm());
  const auto a = loop.run(stop.token(), BenchTime(0));
  EXPECT_EQ(a->reason, StopReason::requested);
  EXPECT_EQ(a->cycles_run, 10u);
  by_token = false;
  const auto b = loop.run({}, BenchTime(0));
  EXPECT_EQ(b->reason, StopReason::failed);
  EXPECT_EQ(b->cycles_run, 10u);
}

TEST(Executive, CountsGridPointsWithinADuration) {
  EXPECT_EQ(cycles_in(seconds(10), milliseconds(1)), 10'000u);
  EXPECT_EQ(cycles_in(Duration(1), milliseconds(1)), 1u);
  EXPECT_EQ(cycles_in(Duration(0), milliseconds(1)), 0u);
}

TEST(Executive, IsArmedAgainAfterAHookThrew) {
  struct ThrowsOnce final : ExecutiveHooks {
    void before_cycle(BenchTime) override {
      if (++calls == 3) throw std::runtime_error("no source answers");
    }
    int calls = 0;
  } hooks;
  Heartbeat heartbeat;
  ExecutiveConfig config = virtual_config(5);
  config.hooks = &hooks;
  config.heartbeat = &heartbeat;
  Executive loop(config);
  ASSERT_TRUE(loop.add_step({.name = "app"}, kNothing));
  ASSERT_TRUE(loop.arm());
  StopSource stop;
  EXPECT_THROW((void)loop.run(stop.token(), BenchTime{}), std::runtime_error);
  EXPECT_EQ(loop.state(), Executive::State::armed);
  EXPECT_EQ(heartbeat.stop_reason(), StopReason::failed);
  const auto second = loop.run(stop.token(), BenchTime{});
  ASSERT_TRUE(second) << second.error().text();
  EXPECT_EQ(second->cycles_run, 5u);
}

}  // namespace
}  // namespace rigor
