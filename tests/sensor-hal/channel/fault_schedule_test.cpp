// When faults are on: by schedule, by trigger, asked for while a run goes on; and what is refused.
#include <thread>

#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(Fault, IsOnBySchedulePeriodAndTrigger) {
  FaultRun run(kRegisters,
               "{kind: bias, value: b, amount: 1, every_s: 0.5, for_s: 0.1, from_s: 0.2, until_s: 2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(3));
  for (const Seen& s : run.seen) {
    const std::int64_t ms = s.at.ns() / 1'000'000;
    const bool on = ms >= 200 && ms < 2000 && (ms - 200) % 500 < 100;
    EXPECT_EQ(std::get<RegisterBlock>(s.info).value[1], on ? 101 : 100) << ms;
  }
  EXPECT_EQ(run.fault(0).count.begins, 4u);
  EXPECT_EQ(run.events.size(), 8u);
  EXPECT_EQ(run.fault(0).span_count, 4u);
}

/// A channel `left` with faults whose triggers look at `table`, whose register a counts its samples.
struct TwoChannels {
  explicit TwoChannels(const std::string& faults, const std::string& table_faults = "")
      : left(kRegisters, faults), table(kRegisters, table_faults) {
    if (!left.status) return;
    status = left.bench.bind(
        {{"left", &left.source.describe(), &left.port}, {"table", &table.source.describe(), &table.port}});
  }
  void until(Duration end) {
    for (; Duration(left.cycle * 1'000'000) < end;) {
      left.until(left.cycle * milliseconds(1) + milliseconds(1));
      table.until(table.cycle * milliseconds(1) + milliseconds(1));
    }
  }
  FaultRun left, table;
  Status status;
};

TEST(Fault, IsTriggeredByAnotherChannel) {
  TwoChannels above("{kind: bias, value: b, amount: 1, when: {channel: table, value: a, above: 30}}");
  ASSERT_TRUE(above.status) << above.status.error().text();
  above.until(milliseconds(600));
  for (const Seen& s : above.left.seen)
    EXPECT_EQ(std::get<RegisterBlock>(s.info).value[1], s.stamp.sequence > 31 ? 101 : 100)
        << s.stamp.sequence;

  TwoChannels gone("{kind: drop, when: {channel: table, is: disconnected}}",
                   "{kind: disconnect, from_s: 1, until_s: 2}");
  ASSERT_TRUE(gone.status) << gone.status.error().text();
  gone.until(seconds(3));
  // Lost until the sample after the return, which comes in the cycle of the 101st.
  EXPECT_EQ(gone.left.source.accounts().dropped, 101u);

  TwoChannels late("{kind: drop, for_s: 0.5, when: {channel: table, is: overdue}}",
                   "{kind: delay, delay_ms: 5, from_s: 1, until_s: 1.02}");
  ASSERT_TRUE(late.status) << late.status.error().text();
  late.until(seconds(3));
  EXPECT_NEAR(static_cast<double>(late.left.source.accounts().dropped), 50, 2);

  TwoChannels misspelt("{kind: drop, when: {channel: tabel, value: a, above: 30}}");
  ASSERT_FALSE(misspelt.status);
  EXPECT_THAT(misspelt.status.error().text(),
              AllOf(HasSubstr("rig.yaml:1:"), HasSubstr("did you mean 'table'?")));
  TwoChannels no_value("{kind: drop, when: {channel: table, value: aa, above: 30}}");
  ASSERT_FALSE(no_value.status);
  EXPECT_THAT(no_value.status.error().text(), HasSubstr("expected one of a, b"));
}

TEST(Fault, InjectedWhileTheRunGoesOnTakesEffectInTheNextCycleAndComesAgainFromTheRecord) {
  const auto node = [](const std::string& yaml) { return *ConfigDocument::parse(yaml, "fault"); };
  FaultRun run(kRegisters, "{kind: drop, probability: 0.01}");
  run.until(milliseconds(500));
  const auto index = run.bench.inject("left", node("{kind: noise, value: b, sigma: 3, for_s: 0.25}"));
  ASSERT_TRUE(index) << index.error().text();
  EXPECT_EQ(*index, 1u);
  run.until(seconds(1));
  ASSERT_TRUE(run.bench.inject("left", node("{kind: drop}")));
  run.until(milliseconds(1200));
  ASSERT_TRUE(run.bench.clear("left"));
  run.until(seconds(2));
  run.expect_accounted();
  EXPECT_THAT(run.events,
              ::testing::Contains(HasSubstr("live fault 1 of left begins in cycle 500: {kind: noise")));
  EXPECT_THAT(run.events, ::testing::Contains(HasSubstr("live fault 1 of left ends in cycle 750")));
  EXPECT_THAT(run.events, ::testing::Contains(HasSubstr("live fault 2 of left ends in cycle 1200")));
  EXPECT_NEAR(static_cast<double>(run.source.accounts().dropped), 20, 6);

  FaultRun again(kRegisters, "{kind: drop, probability: 0.01}");
  ASSERT_TRUE(again.source.stop());
  auto& faults = again.source.faults();
  ASSERT_TRUE(faults.schedule_live(node("{kind: noise, value: b, sigma: 3, for_s: 0.25}"), 1,
                                   milliseconds(500), milliseconds(750)));
  ASSERT_TRUE(faults.schedule_live(node("{kind: drop}"), 2, seconds(1), milliseconds(1200)));
  ArmContext context;
  context.virtual_time = true;
  ASSERT_TRUE(again.source.arm(context));
  ASSERT_TRUE(again.source.start(BenchTime(0)));
  again.until(seconds(2));
  EXPECT_EQ(again.sequences(), run.sequences());
  EXPECT_EQ(again.values(1), run.values(1));
  EXPECT_EQ(again.events, run.events);

  const auto refused = run.bench.inject("lef", node("{kind: drop}"));
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("did you mean 'left'?"));
  EXPECT_FALSE(run.bench.inject("left", node("{kind: drop, from_s: 3}"))) << "a live fault begins at once";
}

TEST(Fault, ThereIsALimitOfFaultsAndClearedOnesMakeRoom) {
  FaultRun run(kRegisters, "");
  const auto node = *ConfigDocument::parse("{kind: delay, delay_ms: 1}", "fault");
  for (int round = 0; round < 3; ++round) {
    for (std::size_t i = 0; i < FaultInjector::kMost; ++i) ASSERT_TRUE(run.bench.inject("left", node)) << i;
    const auto one_more = run.bench.inject("left", node);
    ASSERT_FALSE(one_more);
    EXPECT_EQ(one_more.error().code, ErrorCode::unavailable);
    run.until(run.cycle * milliseconds(1) + milliseconds(20));
    ASSERT_TRUE(run.bench.clear(""));
    run.until(run.cycle * milliseconds(1) + milliseconds(20));
  }
  run.expect_accounted();
}

TEST(Fault, OfLiveOnesThatAreOverTheLastAreRememberedEachAndEarlierOnesAsASum) {
  FaultRun run(kRegisters, "{kind: delay, delay_ms: 1, from_s: 100}");
  const auto node = *ConfigDocument::parse("{kind: drop, for_s: 0.01}", "fault");
  constexpr std::size_t kMore = 10, kAll = FaultInjector::kRemembered + kMore;
  for (std::size_t i = 0; i < kAll; ++i) {
    const auto index = run.bench.inject("left", node);
    ASSERT_TRUE(index) << index.error().text();
    EXPECT_EQ(*index, i + 1);
    run.until(run.cycle * milliseconds(1) + milliseconds(20));
  }
  const FaultInjector& faults = run.source.faults();
  ASSERT_EQ(faults.live().size(), FaultInjector::kRemembered + 1)
      << "the last one came after the others had been counted";
  EXPECT_EQ(faults.live().front()->index, kMore);
  EXPECT_EQ(faults.live().back()->index, kAll);
  EXPECT_EQ(faults.scheduled().size(), 1u);
  EXPECT_EQ(faults.earlier().faults, kMore - 1);
  EXPECT_EQ(faults.earlier().begins, kMore - 1);
  std::uint64_t seen = faults.earlier().seen, dropped = faults.earlier().dropped;
  EXPECT_GT(dropped, 0u);
  for (const auto& f : faults.live()) {
    EXPECT_EQ(f->count.begins, 1u);
    EXPECT_EQ(f->span_count, 1u);
    EXPECT_EQ(f->spans[0].until - f->spans[0].from, milliseconds(10));
    seen += f->count.seen, dropped += f->count.dropped;
  }
  EXPECT_EQ(seen, kAll) << "one of two samples";
  EXPECT_EQ(dropped, run.source.accounts().dropped);
  run.expect_accounted();
}

// The loop must have let go of a fault before it is forgotten, also where it was ended before it began.
TEST(Fault, OnesThatWereClearedBeforeTheyBeganAreForgottenToo) {
  FaultRun run(kRegisters, "");
  const auto node = *ConfigDocument::parse("{kind: drop}", "fault");
  for (int round = 0; round < 20; ++round) {
    for (std::size_t i = 0; i < FaultInjector::kMost; ++i) ASSERT_TRUE(run.bench.inject("left", node));
    ASSERT_TRUE(run.bench.clear("left"));
    run.until(run.cycle * milliseconds(1) + milliseconds(2));
  }
  EXPECT_LE(run.source.faults().live().size(), FaultInjector::kRemembered + FaultInjector::kMost);
  EXPECT_EQ(run.source.faults().earlier().begins, 0u);
}

// Whoever injects is on a thread of its own, and need not know that the run ends.
TEST(Fault, LiveOnesAreRefusedFromTheEndOfTheRunOnWhateverThreadIsAtIt) {
  const auto node = *ConfigDocument::parse("{kind: noise, value: b, sigma: 1, for_s: 0.001}", "fault");
  for (int round = 0; round < 20; ++round) {
    FaultRun run(kRegisters, "");
    std::atomic<bool> injecting{false};
    ErrorCode refused = ErrorCode::internal;
    std::thread other([&] {
      while (true) {
        const auto index = run.bench.inject("left", node);
        injecting = true;
        if (index || index.error().code == ErrorCode::unavailable) continue;  // there were too many for now
        refused = index.error().code;
        return;
      }
    });
    while (!injecting) std::this_thread::yield();
    run.until(milliseconds(20));
    EXPECT_TRUE(run.source.stop());
    other.join();
    EXPECT_EQ(refused, ErrorCode::wrong_state);
    const auto later = run.bench.inject("left", node);
    ASSERT_FALSE(later);
    EXPECT_EQ(later.error().code, ErrorCode::wrong_state) << later.error().text();
    ArmContext context;
    context.virtual_time = true;
    ASSERT_TRUE(run.source.arm(context));
    ASSERT_TRUE(run.source.start(BenchTime(0)));
    run.cycle = 0;
    run.until(milliseconds(20));  // takes up what was asked for last in the run before
    EXPECT_TRUE(run.bench.inject("left", node)) << "of the next run";
  }
}

TEST(Fault, WhatDoesNotFitIsRefusedWithItsPlace) {
  const auto refused = [](SampleKind kind, const std::string& faults) {
    FaultySource source(std::make_unique<FormulaStream>());
    const auto s = source.configure(fault_config(kind, faults));
    EXPECT_FALSE(s) << faults;
    return s ? std::string() : s.error().text();
  };
  EXPECT_THAT(refused(kRegisters, "{kind: dorp}"),
              AllOf(HasSubstr("rig.yaml:1:18: "), HasSubstr("kind"), HasSubstr("did you mean 'drop'?")));
  EXPECT_THAT(refused(kRegisters, "{kind: corrupt}"), HasSubstr("expected a fault that left can have"));
  EXPECT_THAT(refused(SampleKind::event, "{kind: bias, amount: 1}"), HasSubstr("can have"));
  EXPECT_THAT(refused(kRegisters, "{kind: bias, amount: 1}"), HasSubstr("value"));
  EXPECT_THAT(refused(kRegisters, "{kind: bias, value: c, amount: 1}"), HasSubstr("expected one of a, b"));
  EXPECT_THAT(refused(SampleKind::image, "{kind: bias, amount_m: 1}"), HasSubstr("amount_dn"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, probability: 1.5}"), HasSubstr("probability"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, from_s: 2, until_s: 1}"), HasSubstr("until_s"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, every_s: 2}"), HasSubstr("for_s"));
  EXPECT_THAT(refused(kRegisters, "{kind: disconnect, probability: 0.5}"), HasSubstr("unknown key"));
  EXPECT_THAT(refused(kRegisters, "{kind: burst_loss, share: 0.9, mean_burst: 2}"), HasSubstr("mean_burst"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, when: {channel: x}}"), HasSubstr("above"));
}

}  // namespace
}  // namespace rigor::test
