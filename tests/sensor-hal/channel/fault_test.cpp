// What each kind of fault does to the samples of a source as they come: losses, delays, clocks; and that
// every sample is accounted for.
#include <cmath>
#include <set>

#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(Fault, WithoutFaultsEverySampleIsHandedOnAsItCame) {
  FaultRun run(kRegisters, "");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(1));
  ASSERT_EQ(run.seen.size(), 100u);
  for (std::size_t i = 0; i < 100; ++i) {
    EXPECT_EQ(run.seen[i].stamp.sequence, i);
    EXPECT_EQ(run.seen[i].at, run.seen[i].stamp.t_release);
    EXPECT_EQ(run.seen[i].stamp.validity, kValid);
  }
  run.expect_accounted();
  EXPECT_TRUE(run.events.empty());
}

TEST(Fault, DropLosesItsShareAndTheNextSampleSaysSo) {
  FaultRun run(kRegisters, "{kind: drop, probability: 0.2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(50));
  const auto& a = run.source.accounts();
  // 5000 draws at 0.2: sigma is 28.
  EXPECT_NEAR(static_cast<double>(a.dropped), 1000, 5 * 28.3);
  EXPECT_EQ(a.dropped, run.fault(0).count.dropped);
  EXPECT_EQ(run.fault(0).count.seen, 5000u);
  run.expect_accounted();
  std::uint64_t said = 0;
  for (const Seen& s : run.seen) said += s.stamp.lost_before;
  EXPECT_NEAR(static_cast<double>(said), static_cast<double>(a.dropped), 5);
  EXPECT_EQ(run.port.counters().lost_samples, said);
  EXPECT_EQ(run.source.health().lost, a.dropped);
}

TEST(Fault, BurstLossHasTheStatedShareAndMeanLength) {
  FaultRun run(kRegisters, "{kind: burst_loss, share: 0.25, mean_burst: 8}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(400));
  std::size_t bursts = 0, lost = 0;
  std::uint64_t expected = 0;
  for (const std::uint64_t k : run.sequences()) {
    bursts += k > expected;
    lost += k - expected;
    expected = k + 1;
  }
  ASSERT_GT(bursts, 100u);
  // Lengths are geometric with sigma 7.5, some 1250 of them; cycles of 32 samples.
  EXPECT_NEAR(static_cast<double>(lost) / static_cast<double>(bursts), 8, 5 * 7.5 / std::sqrt(1250));
  EXPECT_NEAR(static_cast<double>(lost) / 40000, 0.25, 0.04);
  run.expect_accounted();
}

TEST(Fault, DelayMakesThePortLateAndKeepsTheOrder) {
  FaultRun run(kRegisters, "{kind: delay, delay_ms: 25, from_s: 1, until_s: 2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(3));
  run.expect_accounted();
  EXPECT_EQ(run.seen.size(), 300u);
  for (const Seen& s : run.seen) {
    const Duration behind = s.at - s.stamp.t_release;
    EXPECT_EQ(s.stamp.t_arrival - s.stamp.t_release, behind);
    const bool on =
        s.stamp.t_release >= BenchTime(0) + seconds(1) && s.stamp.t_release < BenchTime(0) + seconds(2);
    // Those just after it wait behind the last delayed ones.
    if (on || s.stamp.t_release > BenchTime(0) + milliseconds(2030)) {
      EXPECT_EQ(behind, on ? milliseconds(25) : Duration(0)) << s.stamp.sequence;
    }
  }
  EXPECT_TRUE(run.showed(PortStatus::overdue, milliseconds(1005), milliseconds(1100)));
  EXPECT_FALSE(run.showed(PortStatus::overdue, milliseconds(0), seconds(1)));
  EXPECT_FALSE(run.showed(PortStatus::overdue, milliseconds(2100), seconds(3)));
  EXPECT_GE(run.fault(0).count.delayed, 99u);
  EXPECT_GE(run.port.counters().late_samples, 99u);
}

TEST(Fault, JitterHasTheStatedDistribution) {
  struct Case {
    const char* keys;
    double mean_ms, sigma_ms;
  };
  for (const Case& c : {Case{"shape: uniform, min_ms: 1, max_ms: 7", 4, 6 / std::sqrt(12)},
                        Case{"shape: exponential, mean_ms: 1", 1, 1},
                        Case{"shape: normal, mean_ms: 4, sigma_ms: 0.5", 4, 0.5}}) {
    FaultRun run(kRegisters, std::string("{kind: jitter, ") + c.keys + "}");
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(seconds(40));
    double sum = 0, squares = 0, n = 0;
    for (const Seen& s : run.seen) {
      const double d_ms = (s.stamp.t_arrival - s.stamp.t_release).seconds() * 1e3;
      EXPECT_GE(d_ms, 0);
      sum += d_ms, squares += d_ms * d_ms, n += 1;
    }
    const double mean = sum / n, sigma = std::sqrt(squares / n - mean * mean);
    EXPECT_NEAR(mean, c.mean_ms, 5 * c.sigma_ms / std::sqrt(n)) << c.keys;
    // The fourth moment of an exponential is nine times its variance squared.
    EXPECT_NEAR(sigma, c.sigma_ms, 5 * c.sigma_ms * std::sqrt(8 / (4 * n))) << c.keys;
    run.expect_accounted();
  }
}

TEST(Fault, StuckRepeatsTheFirstValueWithNewStampsOrWithTheOldOne) {
  for (const bool freeze : {false, true}) {
    FaultRun run(kRegisters, std::string("{kind: stuck, from_s: 1, until_s: 2, freeze: ") +
                                 (freeze ? "true}" : "false}"));
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(seconds(3));
    ASSERT_EQ(run.seen.size(), 300u);
    const auto a = run.values(0);
    double frozen = -1;
    for (const Seen& s : run.seen) {
      const auto k = static_cast<double>(s.stamp.sequence);
      const double v = a[s.stamp.sequence];
      if (s.at < BenchTime(0) + seconds(1) || s.at >= BenchTime(0) + seconds(2)) {
        EXPECT_EQ(v, k);
        continue;
      }
      if (frozen < 0) frozen = v;
      EXPECT_EQ(v, frozen);
      const auto t = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(freeze ? frozen : k);
      EXPECT_EQ(s.stamp.t_capture, t);
    }
    EXPECT_EQ(frozen, 100);
    EXPECT_EQ(run.fault(0).count.changed, 99u);
    run.expect_accounted();
  }
}

TEST(Fault, TimestampsAndClocksMoveCaptureAndRelease) {
  FaultRun wrong(kRegisters, "{kind: timestamp, offset_ms: 50, probability: 0.1}");
  ASSERT_TRUE(wrong.status) << wrong.status.error().text();
  wrong.until(seconds(5));
  int moved = 0;
  for (const Seen& s : wrong.seen) {
    const Duration off =
        s.stamp.t_capture - (BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(s.stamp.sequence));
    EXPECT_TRUE(off == Duration(0) || off == milliseconds(50));
    EXPECT_EQ(s.stamp.t_release - s.stamp.t_capture, milliseconds(5));
    EXPECT_GE(s.at, s.stamp.t_release);
    moved += off != Duration(0);
  }
  EXPECT_NEAR(moved, 50, 5 * 7);
  EXPECT_GE(wrong.fault(0).count.changed, static_cast<std::uint64_t>(moved));
  EXPECT_LE(wrong.fault(0).count.changed,
            static_cast<std::uint64_t>(moved) + wrong.source.accounts().waiting);

  FaultRun skew(kRegisters, "{kind: clock_skew, ppm: 1000, from_s: 1}");
  skew.until(seconds(11));
  const Stamp& last = skew.seen.back().stamp;
  const BenchTime truth = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(last.sequence);
  EXPECT_NEAR((last.t_capture - truth).seconds(), (truth - (BenchTime(0) + seconds(1))).seconds() * 1e-3,
              1e-8);

  FaultRun step(kRegisters, "{kind: clock_step, step_ms: -200, from_s: 1}");
  step.until(seconds(2));
  EXPECT_EQ(step.seen.size(), 200u);
  const Stamp& back = step.seen.back().stamp;
  EXPECT_EQ(back.t_capture,
            BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(back.sequence) - milliseconds(200));
  EXPECT_EQ(back.t_arrival - back.t_release, milliseconds(200)) << "it came when it came";
  for (const auto* run : {&wrong, &skew, &step}) run->expect_accounted();
}

TEST(Fault, DisconnectIsSeenAsLostAndCountedAndTheDeviceComesBack) {
  FaultRun run(kRegisters, "{kind: disconnect, from_s: 1, until_s: 1.5}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(milliseconds(1200));
  EXPECT_FALSE(run.source.health().connected);
  EXPECT_EQ(run.port.status(), PortStatus::disconnected);
  EXPECT_EQ(run.source.health().reconnects, 0u);
  run.until(seconds(3));
  EXPECT_TRUE(run.source.health().connected);
  EXPECT_EQ(run.source.health().reconnects, 1u);
  EXPECT_FALSE(run.showed(PortStatus::disconnected, milliseconds(100), milliseconds(999)));
  EXPECT_FALSE(run.showed(PortStatus::disconnected, milliseconds(1600), seconds(3)));
  EXPECT_EQ(run.source.accounts().disconnected, 50u);
  EXPECT_EQ(run.source.health().lost, 50u);
  EXPECT_EQ(run.port.counters().lost_samples, 50u);
  run.expect_accounted();
  ASSERT_EQ(run.events.size(), 2u);
  EXPECT_THAT(run.events[0], HasSubstr("fault 0 of left begins in cycle 1000: {kind: disconnect"));
  EXPECT_THAT(run.events[1], AllOf(HasSubstr("fault 0 of left ends in cycle 1500"), HasSubstr("50 dropped")));
}

TEST(Fault, ASlowConsumerShowsInTheSourcesOwnCounters) {
  for (const char* mode : {"unread", "hold, leases: 16"}) {
    FaultRun run(kRegisters, std::string("{kind: slow_consumer, mode: ") + mode + ", from_s: 1, until_s: 2}");
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(milliseconds(1900));
    HealthSnapshot inner = run.source.inner().health();
    const std::uint64_t backed_up = inner.no_slot + inner.ring_full;
    EXPECT_GT(backed_up, 50u) << mode;
    run.until(seconds(4));
    inner = run.source.inner().health();
    EXPECT_EQ(run.seen.back().stamp.sequence, 399u) << mode;
    EXPECT_EQ(inner.received, run.source.accounts().taken + inner.no_slot + inner.ring_full) << mode;
    EXPECT_EQ(run.port.counters().lost_samples, inner.no_slot + inner.ring_full) << mode;
    run.expect_accounted();
  }
}

TEST(Fault, DrawsDifferByFaultChannelAndSeedAndRepeat) {
  const auto dropped = [](const std::string& faults, std::uint64_t seed, const std::string& name) {
    FaultySource source(std::make_unique<FormulaStream>());
    auto config = fault_config(kRegisters, faults);
    config.seed = seed;
    config.name = name;
    EXPECT_TRUE(source.configure(config));
    ArmContext context;
    context.virtual_time = true;
    EXPECT_TRUE(source.arm(context));
    EXPECT_TRUE(source.start(BenchTime(0)));
    std::set<std::uint64_t> seen;
    for (int k = 0; k < 2000; ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(k);
      source.complete_until(now);
      while (SampleLease s = source.poll(now)) seen.insert(s->stamp.sequence);
      source.begin_cycle(now);
    }
    return seen;
  };
  const std::string one = "{kind: drop, probability: 0.5}";
  const auto first = dropped(one, 7, "left");
  EXPECT_EQ(first, dropped(one, 7, "left"));
  EXPECT_NE(first, dropped(one, 8, "left"));
  EXPECT_NE(first, dropped(one, 7, "right"));
  // A second fault in front takes the index 0, and the draws of it.
  EXPECT_NE(first, dropped("{kind: delay, delay_ms: 1, from_s: 100}, " + one, 7, "left"));
}

/// Keeps a lease of what it gave, which a source must not.
class KeepsTheNewest final : public Source {
 public:
  SampleLease poll(BenchTime now) noexcept override {
    SampleLease sample = inner_.poll(now);
    if (sample) newest_ = sample;
    return sample;
  }
  void complete_until(BenchTime now) override { inner_.complete_until(now); }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    if (auto s = inner_.configure(config); !s) return s;
    description_ = inner_.describe();
    return {};
  }
  Status do_arm(const ArmContext& context) override { return inner_.arm(context); }
  Status do_start(BenchTime t0) override { return inner_.start(t0); }
  Status do_stop() override { return inner_.stop(); }

 private:
  FormulaStream inner_;
  SampleLease newest_;
};

TEST(Fault, CountsSamplesThatCannotBeStampedBecauseTheirSourceSharesThem) {
  FaultRun run(SampleKind::image, "{kind: timestamp, offset_ms: 1, from_s: 0.5, until_s: 1}", nullptr,
               std::make_unique<KeepsTheNewest>());
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(2));
  EXPECT_EQ(run.source.accounts().no_slot, 50u);
  run.expect_accounted();
  ASSERT_EQ(run.seen.size(), 150u);
  EXPECT_EQ(run.seen[49].stamp.sequence, 49u);
  EXPECT_EQ(run.seen[50].stamp.sequence, 100u);
}

}  // namespace
}  // namespace rigor::test
