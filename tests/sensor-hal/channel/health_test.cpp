// Health of channels that stand in front of others: at any time that of the one behind and their own.
#include <atomic>
#include <ostream>
#include <thread>

#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/typed_source.h"
#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor {

std::ostream& operator<<(std::ostream& out, const HealthSnapshot& h) {
  return out << (h.connected ? "connected" : "away") << ", received " << h.received << ", incomplete "
             << h.incomplete << ", lost " << h.lost << ", no slot " << h.no_slot << ", ring full "
             << h.ring_full << ", protocol errors " << h.protocol_errors << ", retries " << h.retries
             << ", reconnects " << h.reconnects;
}

namespace test {
namespace {

/// Counts what the test says, and gives no sample.
class Counting final : public FollowerSource {
 public:
  void count(std::uint64_t n) {
    health_.connected = true;
    health_.received += n;
    health_.incomplete += 2 * n;
    health_.lost += 3 * n;
    health_.no_slot += 4 * n;
    health_.ring_full += 5 * n;
    health_.protocol_errors += 6 * n;
    health_.retries += 7 * n;
    health_.reconnects += 8 * n;
  }
  void go() { health_.connected = false; }
  SampleLease poll(BenchTime) noexcept override { return {}; }
  bool request_at(std::uint64_t, BenchTime) noexcept override { return false; }

 protected:
  Status do_configure(const ChannelConfig& c) override {
    description_.kind = c.kind;
    description_.names = {"x_m", "y_m", "yaw_deg"};
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_stop() override {
    go();
    return {};
  }
};

HealthSnapshot counted(std::uint64_t n, bool connected = true) {
  return {connected, n, 2 * n, 3 * n, 4 * n, 5 * n, 6 * n, 7 * n, 8 * n};
}

TEST(Health, OfADecoratorIsThatOfTheSourceBehindItNow) {
  auto inner = std::make_unique<Counting>();
  Counting& device = *inner;
  FaultySource source(std::make_unique<TypedSource>(std::move(inner)));
  EXPECT_EQ(source.health(), HealthSnapshot{});
  ASSERT_TRUE(source.configure(fault_config(SampleKind::odometry, "")));
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  device.count(1);
  EXPECT_EQ(source.health(), counted(1)) << "armed";
  ASSERT_TRUE(source.start(BenchTime(0)));
  device.count(2);
  EXPECT_EQ(source.health(), counted(3)) << "between two cycles";
  device.go();
  EXPECT_EQ(source.health(), counted(3, false));
  device.count(1);
  ASSERT_TRUE(source.stop());
  EXPECT_EQ(source.health(), counted(4, false)) << "after the run";
}

TEST(Health, OfAPairIsOfBothSidesAndOfTheOneThatIsHandedOn) {
  WorkerPool workers(1);
  auto real = std::make_unique<Counting>(), simulated = std::make_unique<Counting>();
  Counting &device = *real, &simulator = *simulated;
  PairSource pair(std::move(real), std::move(simulated), workers);
  ChannelConfig config = fault_config(kRegisters, "");
  config.params = *ConfigDocument::parse("{active: simulated, real: {}, simulated: {}}", "rig.yaml");
  const auto configured = pair.configure(config);
  ASSERT_TRUE(configured) << configured.error().text();
  ASSERT_TRUE(pair.arm({.virtual_time = true}));
  ASSERT_TRUE(pair.start(BenchTime(0)));
  device.count(1);
  simulator.count(10);
  device.go();
  const auto expected = [](std::uint64_t n, bool connected) {
    HealthSnapshot h = counted(n, connected);
    h.received = h.incomplete = h.ring_full = 0;  // the pair has handed nothing on
    return h;
  };
  EXPECT_EQ(pair.health(), expected(11, true)) << "the simulated side is there";
  pair.switch_to(PairSide::real);
  EXPECT_FALSE(pair.poll(BenchTime(0)));
  EXPECT_EQ(pair.health(), expected(11, false)) << "the device is away";
  device.count(1);
  EXPECT_EQ(pair.health(), expected(12, true));
  ASSERT_TRUE(pair.stop());
  EXPECT_EQ(pair.health(), expected(12, false));
}

TEST(Health, OfAFaultySourceAddsWhatTheFaultsDid) {
  FaultRun run(kRegisters, "{kind: disconnect, from_s: 1, until_s: 2}, {kind: drop, probability: 0.1}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  std::atomic<bool> over{false};
  // Whoever asks, and whenever: no number ever falls.
  std::thread asker([&] {
    HealthSnapshot last;
    for (bool end = false; !end;) {
      end = over.load();
      const HealthSnapshot h = run.source.health();
      EXPECT_GE(h.received, last.received);
      EXPECT_GE(h.lost, last.lost);
      EXPECT_GE(h.reconnects, last.reconnects);
      last = h;
    }
  });
  run.until(milliseconds(1500));
  EXPECT_FALSE(run.source.health().connected);
  EXPECT_TRUE(run.source.inner().health().connected);
  run.until(seconds(20));
  over = true;
  asker.join();
  const HealthSnapshot h = run.source.health(), inner = run.source.inner().health();
  EXPECT_TRUE(h.connected);
  EXPECT_EQ(h.reconnects, inner.reconnects + 1);
  EXPECT_EQ(h.received, inner.received);
  EXPECT_EQ(h.lost, inner.lost + run.source.accounts().dropped + run.source.accounts().disconnected);
  EXPECT_GT(run.source.accounts().dropped, 100u);
}

}  // namespace
}  // namespace test
}  // namespace rigor
