// Commands over real TCP, and the safe state that needs no help from the loop.
#include "drivers/modbus/modbus_sink.h"

#include <cmath>

#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

class ModbusSinkTest : public testing::Test {
 protected:
  static ChannelConfig config(std::uint16_t port, const std::string& more = "") {
    ChannelConfig c;
    c.name = "table_command";
    c.latency = milliseconds(10);
    c.params =
        yaml("address: 127.0.0.1\nport: " + std::to_string(port) + "\n" + more +
             "registers:\n"
             "  - { name: enable, table: holding_registers, address: 0 }\n"
             "  - { name: target_rate, table: holding_registers, address: 4, type: s32, scale: 0.001 }\n"
             "safe: { enable: 0, target_rate: 0 }\n");
    return c;
  }
  void start(const ChannelConfig& c) {
    heartbeat_.restart(false);
    auto s = sink_.configure(c);
    ASSERT_TRUE(s) << s.error().text();
    sink_.watch(&heartbeat_, milliseconds(100));
    s = sink_.arm({});
    ASSERT_TRUE(s) << s.error().text();
    s = sink_.start(bench_now());
    ASSERT_TRUE(s) << s.error().text();
    heartbeat_.beat(bench_now());
  }
  Command make(double enable, double rate, Duration in = milliseconds(10)) {
    Command c;
    c.sequence = ++sequence_;
    c.t_issue = bench_now();
    c.t_effect = c.t_issue + in;
    c.count = 2;
    c.value[0] = enable;
    c.value[1] = rate;
    return c;
  }
  /// A loop that beats while it waits.
  template <class F>
  bool beating(Duration at_most, F&& true_now) {
    return eventually(at_most, [&] {
      heartbeat_.beat(bench_now());
      return true_now();
    });
  }
  std::shared_ptr<Bank> bank_ = std::make_shared<Bank>();
  Heartbeat heartbeat_;
  ModbusSink sink_;
  std::uint64_t sequence_ = 0;
};

TEST_F(ModbusSinkTest, WritesEachCommandAtItsInstant) {
  Device device(bank_);
  start(config(device.port()));
  std::vector<BenchTime> effects;
  for (int i = 1; i <= 20; ++i) {
    const auto c = make(1, i);
    effects.push_back(c.t_effect);
    ASSERT_TRUE(sink_.command(c));
    (void)beating(milliseconds(5), [] { return false; });
  }
  ASSERT_TRUE(beating(seconds(10), [&] { return sink_.counters().applied == 20; }));
  std::vector<Bank::Write> rates;
  for (const auto& w : bank_->writes())
    if (w.address == 4) rates.push_back(w);
  ASSERT_EQ(rates.size(), 21u);  // the first is the safe value of arm
  EXPECT_EQ(rates[0].values, (std::vector<std::uint16_t>{0, 0}));
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(rates[i + 1].values[1], 1000 * (i + 1));
    const auto late = rates[i + 1].t - effects[i];
    EXPECT_GE(late, Duration(0)) << "applied before its instant";
  }
  EXPECT_EQ(bank_->holding(0), 1);
}

TEST_F(ModbusSinkTest, MakesTheDeviceSafeWhenTheLoopHangs) {
  Device device(bank_);
  start(config(device.port()));
  ASSERT_TRUE(sink_.command(make(1, 30)));
  ASSERT_TRUE(beating(seconds(10), [&] { return bank_->holding(0) == 1; }));
  heartbeat_.beat(bench_now());
  const auto silent_since = bench_now();
  ASSERT_TRUE(sink_.command(make(1, 60, milliseconds(200))));  // must not come after the safe state
  ASSERT_TRUE(eventually(seconds(10), [&] { return bank_->holding(0) == 0; }));
  const auto took = bank_->writes().back().t - silent_since;
  EXPECT_GT(took, milliseconds(95)) << "safe before the deadline";
  EXPECT_EQ(sink_.counters().made_safe, 1u);
  (void)eventually(milliseconds(200), [] { return false; });
  EXPECT_EQ(bank_->holding(0), 0);
  EXPECT_EQ(bank_->holding(5), 0);
  EXPECT_EQ(sink_.counters().dropped, 1u);
  // The loop comes back: new commands count again.
  heartbeat_.beat(bench_now());
  (void)beating(milliseconds(20), [] { return false; });
  ASSERT_TRUE(sink_.command(make(1, 20)));
  EXPECT_TRUE(beating(seconds(10), [&] { return bank_->holding(5) == 20000; }));
}

TEST_F(ModbusSinkTest, MakesTheDeviceSafeWhenTheLoopStops) {
  Device device(bank_);
  start(config(device.port()));
  ASSERT_TRUE(sink_.command(make(1, 30)));
  ASSERT_TRUE(beating(seconds(10), [&] { return bank_->holding(0) == 1; }));
  heartbeat_.declare_stopped(StopReason::signal);
  ASSERT_TRUE(eventually(seconds(10), [&] { return bank_->holding(0) == 0 && bank_->holding(5) == 0; }));
}

TEST_F(ModbusSinkTest, MakesTheDeviceSafeAtStopAndWhenItIsDestroyed) {
  Device device(bank_);
  start(config(device.port()));
  ASSERT_TRUE(sink_.command(make(1, 30)));
  ASSERT_TRUE(beating(seconds(10), [&] { return bank_->holding(0) == 1; }));
  ASSERT_TRUE(sink_.stop());
  EXPECT_EQ(bank_->holding(0), 0);
  {
    ModbusSink other;
    ASSERT_TRUE(other.configure(config(device.port())));
    ASSERT_TRUE(other.arm({}));
    ASSERT_TRUE(other.start(bench_now()));
    ASSERT_TRUE(other.command(make(1, 40)));
    ASSERT_TRUE(eventually(seconds(10), [&] { return bank_->holding(0) == 1; }));
  }
  EXPECT_EQ(bank_->holding(0), 0);
}

TEST_F(ModbusSinkTest, KeepsTryingToMakeADeviceSafeThatIsAway) {
  auto device = std::make_unique<Device>(bank_);
  const auto port = device->port();
  start(config(port));
  ASSERT_TRUE(sink_.command(make(1, 30)));
  ASSERT_TRUE(beating(seconds(10), [&] { return bank_->holding(0) == 1; }));
  device.reset();
  heartbeat_.declare_stopped(StopReason::signal);
  (void)eventually(milliseconds(300), [] { return false; });
  EXPECT_FALSE(sink_.health().connected);
  EXPECT_EQ(bank_->holding(0), 1);
  device = std::make_unique<Device>(bank_, port);
  EXPECT_TRUE(eventually(seconds(4), [&] { return bank_->holding(0) == 0; }));
}

TEST_F(ModbusSinkTest, WritesTheLastCommandAgainAfterAReconnect) {
  auto device = std::make_unique<Device>(bank_);
  const auto port = device->port();
  start(config(port));
  ASSERT_TRUE(sink_.command(make(1, 30)));
  ASSERT_TRUE(beating(seconds(10), [&] { return bank_->holding(5) == 30000; }));
  device.reset();
  bank_->set(RegisterTable::holding_registers, 0, {0, 0, 0, 0, 0, 0});  // it was switched off and on
  ASSERT_TRUE(sink_.command(make(1, 31)));
  ASSERT_TRUE(beating(seconds(10), [&] { return !sink_.health().connected; }));
  device = std::make_unique<Device>(bank_, port);
  EXPECT_TRUE(beating(seconds(4), [&] { return bank_->holding(5) == 31000; }));
  EXPECT_EQ(bank_->holding(0), 1);
}

TEST_F(ModbusSinkTest, RefusesWholeCommandsThatDoNotFit) {
  Device device(bank_);
  start(config(device.port()));
  ASSERT_TRUE(sink_.command(make(1, 1e9)));
  ASSERT_TRUE(sink_.command(make(std::nan(""), 1)));
  auto wrong_count = make(1, 1);
  wrong_count.count = 1;
  ASSERT_TRUE(sink_.command(wrong_count));
  ASSERT_TRUE(beating(seconds(10), [&] { return sink_.counters().failed == 3; }));
  EXPECT_EQ(bank_->holding(0), 0);
  EXPECT_EQ(sink_.counters().applied, 0u);
}

TEST_F(ModbusSinkTest, CountsCommandsThatCameTooLate) {
  Device device(bank_);
  start(config(device.port()));
  ASSERT_TRUE(sink_.command(make(1, 5, milliseconds(-50))));
  ASSERT_TRUE(beating(seconds(10), [&] { return sink_.counters().applied == 1; }));
  EXPECT_EQ(sink_.counters().late, 1u);
}

TEST_F(ModbusSinkTest, ReadsBackWhatItWroteWhereAsked) {
  Device device(bank_);
  start(config(device.port(), "verify: true\n"));
  ASSERT_TRUE(sink_.command(make(1, 5)));
  ASSERT_TRUE(beating(seconds(10), [&] { return sink_.counters().applied == 1; }));
  bank_->on_read(
      [](BenchTime, Bank::Tables& t) { t[3][4] = 77; });  // a device that does not keep what it was told
  ASSERT_TRUE(sink_.command(make(1, 6)));
  ASSERT_TRUE(beating(seconds(10), [&] { return sink_.counters().failed == 1; }));
}

TEST_F(ModbusSinkTest, FullRingIsSaidToTheLoop) {
  Device device(bank_);
  start(config(device.port()));
  int taken = 0;
  for (int i = 0; i < 2000; ++i) taken += sink_.command(make(1, 1, seconds(100)));
  EXPECT_LT(taken, 2000);
  EXPECT_EQ(sink_.counters().accepted, static_cast<std::uint64_t>(taken));
  EXPECT_EQ(sink_.counters().dropped, static_cast<std::uint64_t>(2000 - taken));
}

TEST_F(ModbusSinkTest, NeedsASafeState) {
  auto c = config(5020);
  c.params = yaml("address: x\nregisters: [{ name: a, table: coils, address: 0 }]\n");
  EXPECT_EQ(sink_.configure(c).error().text(),
            "rig.yaml:1:1: safe: expected a map, got nothing: the key is missing");
  c.params = yaml("address: x\nregisters: [{ name: a, table: coils, address: 0 }]\nsafe: { b: 0 }\n");
  EXPECT_EQ(sink_.configure(c).error().text(), "rig.yaml:3:9: safe.b: unknown key; expected a");
  c.params = yaml("address: x\nregisters: [{ name: a, table: coils, address: 0 }]\nsafe: { a: 2 }\n");
  EXPECT_EQ(sink_.configure(c).error().text(),
            "rig.yaml:3:12: safe.a: expected a value that the register can hold, got one that it cannot");
}

}  // namespace
}  // namespace rigor::modbus
