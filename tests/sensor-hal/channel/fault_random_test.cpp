// Faults at random on every kind of sample: nothing hangs, every loss is accounted for.
#include <random>

#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

std::string random_fault(std::mt19937& random, SampleKind kind) {
  const auto pick = [&](std::initializer_list<const char*> of) {
    return std::string(*(of.begin() + static_cast<std::ptrdiff_t>(random() % of.size())));
  };
  const bool elements = has_elements(kind);
  std::string value, unit;
  if (kind == kRegisters) value = ", value: " + pick({"a", "b"});
  if (kind == SampleKind::can_frame) value = ", value: " + pick({"byte_0", "byte_7", "byte_63"});
  if (kind == SampleKind::pose) value = ", value: " + pick({"x", "z"}), unit = "_m";
  if (kind == SampleKind::imu) value = ", value: " + pick({"rate_x", "rate_z"}), unit = "_radps";
  if (kind == SampleKind::nav_fix) value = ", value: " + pick({"east", "up"}), unit = "_m";
  if (kind == SampleKind::odometry) value = ", value: " + pick({"yaw", "wheel_right"}), unit = "_rad";
  if (kind == SampleKind::image) unit = "_dn";
  if (kind == SampleKind::range_image || kind == SampleKind::point_cloud) unit = "_m";
  while (true) switch (random() % kFaultKinds) {
      case 0:
        return "{kind: drop, probability: 0.5}";
      case 1:
        return "{kind: burst_loss, share: 0.6, mean_burst: 5}";
      case 2:
        return "{kind: delay, delay_ms: " + pick({"0.1", "30", "400"}) + "}";
      case 3:
        return "{kind: jitter, shape: exponential, mean_ms: 20}";
      case 4:
        return "{kind: stuck, freeze: " + pick({"true", "false"}) + "}";
      case 5:
        return "{kind: bias" + value + ", amount" + unit + ": " + pick({"1e6", "-3", "0.5"}) + "}";
      case 6:
        return "{kind: drift" + value + ", rate" + unit + "_per_s: 100}";
      case 7:
        return "{kind: noise" + value + ", sigma" + unit + ": 10}";
      case 8:
        return "{kind: spike" + value + ", amount" + unit + ": 50, probability: 0.5}";
      case 9:
        if (!elements && kind != SampleKind::can_frame) break;
        return "{kind: corrupt, flips: 40, keep: " + pick({"0", "0.33", "1"}) + "}";
      case 10:
        return "{kind: timestamp, offset_ms: " + pick({"-80", "70", "900"}) + ", probability: 0.5}";
      case 11:
        return "{kind: clock_skew, ppm: " + pick({"-100000", "100000"}) + "}";
      case 12:
        return "{kind: clock_step, step_ms: " + pick({"-500", "500"}) + "}";
      case 13:
        return "{kind: disconnect}";
      case 14:
        return "{kind: slow_consumer, mode: " + pick({"unread", "hold, leases: 12"}) + "}";
    }
}

TEST(Fault, AtRandomOnEveryKindOfSampleNothingHangsAndEveryLossIsAccountedFor) {
  WorkerPool workers(2);
  for (const SampleKind kind : {SampleKind::image, SampleKind::range_image, SampleKind::point_cloud,
                                SampleKind::can_frame, SampleKind::register_block, SampleKind::pose,
                                SampleKind::imu, SampleKind::nav_fix, SampleKind::odometry}) {
    SCOPED_TRACE(static_cast<int>(kind));
    std::mt19937 random(static_cast<unsigned>(kind));
    FaultRun run(kind, "", &workers, std::make_unique<FormulaStream>(PixelFormat::mono8, 160, 120));
    ASSERT_TRUE(run.status) << run.status.error().text();
    std::uint64_t handed = 0, overtaken = 0;
    for (int round = 0; round < 60; ++round) {  // of one second each
      for (std::uint32_t n = random() % 4; n > 0; --n) {
        const std::string yaml = random_fault(random, kind);
        const auto node = ConfigDocument::parse(yaml, "fault");
        ASSERT_TRUE(node);
        const auto injected = run.bench.inject("left", *node);
        ASSERT_TRUE(injected) << yaml << ": " << injected.error().text();
      }
      run.until(seconds(round) + milliseconds(700));
      ASSERT_TRUE(run.bench.clear(""));
      run.until(seconds(round + 1));
      for (std::size_t i = 1; i < run.seen.size(); ++i)
        overtaken += run.seen[i].stamp.sequence <= run.seen[i - 1].stamp.sequence;
      handed += run.seen.size();
      run.seen.clear();
      run.statuses.clear();
      run.statuses.resize(static_cast<std::size_t>(run.cycle));
    }
    run.until(seconds(62));
    handed += run.seen.size();
    EXPECT_EQ(overtaken, 0u);
    run.expect_accounted();
    const auto& a = run.source.accounts();
    const HealthSnapshot inner = run.source.inner().health();
    EXPECT_EQ(a.handed_on, handed);
    EXPECT_EQ(a.waiting, 0u) << "all faults are over";
    EXPECT_EQ(inner.received, 6200u) << "none before the decorator vanishes";
    EXPECT_EQ(inner.received, a.taken + inner.no_slot + inner.ring_full);
    std::uint64_t dropped = run.source.faults().earlier().dropped;
    for (const auto& f : run.source.faults().live()) dropped += f->count.dropped;
    EXPECT_EQ(dropped, a.dropped + a.disconnected);
    // A port shows each, or counts it.
    const PortCounters& p = run.port.counters();
    EXPECT_EQ(handed, p.fresh + p.superseded + p.overflow);
    EXPECT_TRUE(run.source.health().connected);
    EXPECT_EQ(run.port.status() == PortStatus::disconnected, false);
  }
}

}  // namespace
}  // namespace rigor::test
