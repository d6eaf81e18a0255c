// Faults of commands on their way to a sink.
#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

class NotedSink final : public Sink {
 public:
  bool command(const Command& c) noexcept override {
    given.push_back(c);
    counters_.accepted.fetch_add(1);
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}
  void apply(std::uint64_t n) { counters_.applied += n, health_.connected = true; }
  std::vector<Command> given;

 protected:
  Status do_configure(const ChannelConfig&) override {
    description_.kind = kRegisters;
    description_.names = {"enable", "rate"};
    description_.units = {"", "deg/s"};
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }
};

/// 1000 commands, one each 10 ms, rate counting up.
std::vector<Command> commanded(const std::string& faults, SinkSnapshot* counters = nullptr) {
  auto noted = std::make_unique<NotedSink>();
  NotedSink& inner = *noted;
  FaultySink sink(std::move(noted));
  const auto s = sink.configure(fault_config(kRegisters, faults));
  EXPECT_TRUE(s) << s.error().text();
  EXPECT_TRUE(sink.arm({}));
  EXPECT_TRUE(sink.start(BenchTime(0)));
  for (int k = 0; k < 1000; ++k) {
    Command c;
    c.sequence = static_cast<std::uint64_t>(k);
    c.t_issue = BenchTime(0) + milliseconds(10 * k);
    c.t_effect = c.t_issue + milliseconds(10);
    c.count = 2;
    c.value[0] = 1;
    c.value[1] = k;
    EXPECT_TRUE(sink.command(c));
  }
  if (counters) *counters = sink.counters();
  EXPECT_TRUE(sink.stop());
  return inner.given;
}

TEST(Fault, ASinksCountersAreThoseOfTheOneBehindNowAndWhatWasLostBeforeIt) {
  auto noted = std::make_unique<NotedSink>();
  NotedSink& inner = *noted;
  FaultySink sink(std::move(noted));
  ASSERT_TRUE(sink.configure(fault_config(kRegisters, "{kind: disconnect}")));
  ASSERT_TRUE(sink.arm({}));
  ASSERT_TRUE(sink.start(BenchTime(0)));
  EXPECT_TRUE(sink.command({}));
  EXPECT_EQ(sink.counters(), (SinkSnapshot{.accepted = 1, .dropped = 1}));
  inner.apply(3);
  EXPECT_EQ(sink.counters(), (SinkSnapshot{.accepted = 1, .applied = 3, .dropped = 1}));
  EXPECT_TRUE(sink.health().connected);
  EXPECT_TRUE(sink.stop());
}

TEST(Fault, CommandsAreLostDelayedChangedAndStuck) {
  SinkSnapshot n;
  EXPECT_NEAR(static_cast<double>(commanded("{kind: drop, probability: 0.2}", &n).size()), 800, 5 * 12.7);
  EXPECT_EQ(n.accepted, 1000u);
  EXPECT_NEAR(static_cast<double>(n.dropped), 200, 5 * 12.7);
  EXPECT_EQ(commanded("{kind: disconnect, from_s: 2, until_s: 3}").size(), 900u);
  EXPECT_NEAR(static_cast<double>(commanded("{kind: burst_loss, share: 0.3, mean_burst: 3}").size()), 700,
              130);

  const auto delayed = commanded("{kind: delay, delay_ms: 35, from_s: 1, until_s: 2}");
  ASSERT_EQ(delayed.size(), 1000u);
  EXPECT_EQ(delayed[150].t_effect - delayed[150].t_issue, milliseconds(45));
  EXPECT_EQ(delayed[150].value[1], 150);
  for (std::size_t i = 1; i < 1000; ++i) EXPECT_GE(delayed[i].t_effect, delayed[i - 1].t_effect);
  EXPECT_EQ(delayed[500].t_effect - delayed[500].t_issue, milliseconds(10));

  const auto stuck = commanded("{kind: stuck, from_s: 5, until_s: 6}");
  EXPECT_EQ(stuck[499].value[1], 499);
  EXPECT_EQ(stuck[599].value[1], 500);
  EXPECT_EQ(stuck[600].value[1], 600);
  EXPECT_EQ(commanded("{kind: bias, value: rate, amount: 0.5}")[10].value[1], 10.5);

  FaultySink sink(std::make_unique<NotedSink>());
  const auto refused = sink.configure(fault_config(kRegisters, "{kind: timestamp, offset_ms: 1}"));
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("takes commands"));
}

}  // namespace
}  // namespace rigor::test
