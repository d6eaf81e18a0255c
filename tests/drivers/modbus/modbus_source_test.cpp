// Registers over real TCP: values, time stamps, and a device that misbehaves or goes away.
#include "drivers/modbus/modbus_source.h"

#include <time.h>

#include <algorithm>
#include <atomic>
#include <cmath>

#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

constexpr const char* kRegisters =
    "registers:\n"
    "  - { name: position, table: input_registers, address: 0, type: s32, scale: 0.001, unit: deg }\n"
    "  - { name: rate, table: input_registers, address: 2, type: f32, byte_order: CDAB, unit: deg/s }\n"
    "  - { name: ready, table: discrete_inputs, address: 3 }\n";

class ModbusSourceTest : public testing::Test {
 protected:
  static ChannelConfig config(std::uint16_t port, const std::string& more = "",
                              Duration period = milliseconds(10)) {
    ChannelConfig c;
    c.name = "table";
    c.kind = SampleKind::register_block;
    c.period = period;
    c.latency = milliseconds(10);
    c.params = yaml("address: 127.0.0.1\nport: " + std::to_string(port) + "\n" + more + kRegisters);
    return c;
  }
  void start(const ChannelConfig& c) {
    auto s = source_.configure(c);
    ASSERT_TRUE(s) << s.error().text();
    s = source_.arm({});
    ASSERT_TRUE(s) << s.error().text();
    t0_ = bench_now() + milliseconds(20);
    s = source_.start(t0_);
    ASSERT_TRUE(s) << s.error().text();
  }
  std::vector<SampleLease> collect(Duration time) {
    std::vector<SampleLease> all;
    const auto end = monotonic_now() + time;
    while (monotonic_now() < end) {
      while (auto s = source_.poll(bench_now())) all.push_back(std::move(s));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return all;
  }
  std::shared_ptr<Bank> bank_ = std::make_shared<Bank>();
  ModbusSource source_;
  BenchTime t0_;
};

TEST_F(ModbusSourceTest, GivesValuesInTheirUnitsWithStamps) {
  bank_->set(RegisterTable::input_registers, 0, {0xFFFF, 0xFA24, 0xE979, 0x42F6});
  bank_->set(RegisterTable::discrete_inputs, 3, {1});
  Device device(bank_);
  start(config(device.port()));
  EXPECT_EQ(source_.describe().names, (std::vector<std::string>{"position", "rate", "ready"}));
  EXPECT_EQ(source_.describe().units, (std::vector<std::string>{"deg", "deg/s", ""}));
  const auto samples = collect(milliseconds(200));
  ASSERT_GE(samples.size(), 5u);
  const auto* block = samples[0]->as<RegisterBlock>();
  ASSERT_NE(block, nullptr);
  EXPECT_EQ(block->count, 3u);
  EXPECT_DOUBLE_EQ(block->value[0], -1.5);
  EXPECT_EQ(block->value[1], double{123.456F});
  EXPECT_EQ(block->value[2], 1);
  const auto& stamp = samples[0]->stamp;
  EXPECT_EQ(stamp.validity, kValid);
  EXPECT_EQ(stamp.t_release - stamp.t_capture, milliseconds(10));
  // Half a round trip is between request and capture, and capture and answer.
  const auto half = stamp.t_arrival - stamp.t_capture;
  EXPECT_GT(half, Duration(0));
  EXPECT_NEAR(stamp.sigma_capture.seconds(), half.seconds() / std::sqrt(3.0), 5e-9);
  // The device's own reads of that sample lie within it.
  bool inside = false;
  for (const auto t : bank_->reads()) inside |= t >= stamp.t_capture - half && t <= stamp.t_arrival;
  EXPECT_TRUE(inside);
}

TEST_F(ModbusSourceTest, HundredHertzForThreeSecondsWithoutALoss) {
  Device device(bank_);
  start(config(device.port()));
  // A thread that does nothing but sleep on the same grid tells what the machine allows.
  std::atomic<bool> done{false};
  std::atomic<std::int64_t> worst_ns{0};
  std::thread reference([&] {
    for (auto t = monotonic_now(); !done.load(); t = t + milliseconds(10)) {
      const timespec when{t.ns() / 1'000'000'000, t.ns() % 1'000'000'000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr);
      worst_ns = std::max(worst_ns.load(), (monotonic_now() - t).ns());
    }
  });
  std::vector<Stamp> stamps;
  const auto end = monotonic_now() + seconds(3) + milliseconds(25);
  while (monotonic_now() < end) {
    while (const auto s = source_.poll(bench_now())) stamps.push_back(s->stamp);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  done = true;
  reference.join();
  ASSERT_GE(stamps.size(), 2u);
  const auto spanned = stamps.back().sequence - stamps.front().sequence + 1;
  EXPECT_LE(spanned - stamps.size(), source_.health().lost) << "samples vanished without a count";
  if (worst_ns > 3'000'000)
    GTEST_SKIP() << "this machine held up a thread that only slept for " << worst_ns / 1'000'000
                 << " ms; lost " << source_.health().lost;
  ASSERT_GE(stamps.size(), 299u);
  std::vector<double> late_ms;
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    const auto& stamp = stamps[i];
    EXPECT_EQ(stamp.sequence, stamps[0].sequence + i);
    EXPECT_EQ(stamp.lost_before, 0u);
    const auto grid = t0_ + milliseconds(10) * static_cast<std::int64_t>(stamp.sequence);
    late_ms.push_back((stamp.t_capture - grid).seconds() * 1e3);
  }
  std::sort(late_ms.begin(), late_ms.end());
  EXPECT_GT(late_ms.front(), 0);
  EXPECT_LT(late_ms[late_ms.size() / 2], 2) << "the grid was not kept";
  EXPECT_EQ(source_.health().lost, 0u);
  std::printf("  capture after its grid instant: p50 %.3f ms, p99 %.3f ms, max %.3f ms\n",
              late_ms[late_ms.size() / 2], late_ms[late_ms.size() * 99 / 100], late_ms.back());
}

TEST_F(ModbusSourceTest, NaNIsHandedOnAndMarked) {
  bank_->set(RegisterTable::input_registers, 2, {0, 0x7FC0});
  Device device(bank_);
  start(config(device.port()));
  const auto samples = collect(milliseconds(100));
  ASSERT_FALSE(samples.empty());
  EXPECT_TRUE(std::isnan(samples[0]->as<RegisterBlock>()->value[1]));
  EXPECT_EQ(samples[0]->stamp.validity, kCorrupt);
}

TEST_F(ModbusSourceTest, ExceptionsAreLossesOnALivingConnection) {
  Device device(bank_);
  start(config(device.port()));
  device->set_faults({.exception_every = 6});
  EXPECT_TRUE(eventually(seconds(20), [&] { return source_.health().protocol_errors >= 3; }));
  device->set_faults({});
  (void)collect(milliseconds(100));
  std::vector<SampleLease> samples;
  EXPECT_TRUE(eventually(seconds(20), [&] {
    for (auto& s : collect(milliseconds(20))) samples.push_back(std::move(s));
    return samples.size() >= 3;
  }));
  EXPECT_GE(source_.health().lost, source_.health().protocol_errors);
  EXPECT_EQ(source_.health().reconnects, 0u);
  ASSERT_FALSE(samples.empty());
  EXPECT_TRUE(source_.health().connected);
}

TEST_F(ModbusSourceTest, SilenceCostsTheSamplesItLastedAndNoMore) {
  Device device(bank_);
  start(config(device.port(), "timeout_ms: 35\n"));
  (void)collect(milliseconds(100));
  const auto lost_before_silence = source_.health().lost;
  const MonotonicTime silent = monotonic_now();
  device->set_faults({.silent_every = 1});
  EXPECT_TRUE(eventually(seconds(20), [&] { return source_.health().retries >= 1; }));
  (void)collect(Duration(1));
  device->set_faults({});
  EXPECT_TRUE(eventually(seconds(20), [&] { return source_.health().connected; }));
  // One for each instant of the grid in this while, the one that was under way, and one at its end.
  const auto lost = source_.health().lost - lost_before_silence;
  EXPECT_LE(lost, static_cast<std::uint64_t>((monotonic_now() - silent) / milliseconds(10)) + 2);
  const auto samples = collect(milliseconds(300));
  ASSERT_GE(samples.size(), 10u);
  // What is missing in the sequence is what was counted: nothing vanished unseen.
  std::uint64_t missing = 0;
  std::uint64_t lost_before = 0;
  for (std::size_t i = 1; i < samples.size(); ++i) {
    missing += samples[i]->stamp.sequence - samples[i - 1]->stamp.sequence - 1;
    lost_before += samples[i]->stamp.lost_before;
  }
  EXPECT_EQ(missing, lost_before);
  EXPECT_GE(source_.health().lost, 3u);
  // Still on the grid.
  const auto& last = samples.back()->stamp;
  const auto off = last.t_capture - (t0_ + milliseconds(10) * static_cast<std::int64_t>(last.sequence));
  EXPECT_LT(std::fabs(off.seconds()), 0.008);
}

TEST_F(ModbusSourceTest, ReturnsWhenTheDeviceDoes) {
  auto device = std::make_unique<Device>(bank_);
  const auto port = device->port();
  start(config(port));
  ASSERT_FALSE(collect(milliseconds(100)).empty());
  device.reset();
  EXPECT_TRUE(eventually(seconds(20), [&] { return !source_.health().connected; }));
  (void)collect(milliseconds(300));
  EXPECT_TRUE(collect(milliseconds(100)).empty());
  EXPECT_GE(source_.health().lost, 30u);
  device = std::make_unique<Device>(bank_, port);
  EXPECT_TRUE(eventually(seconds(20), [&] { return source_.health().connected; }));
  const auto samples = collect(milliseconds(200));
  ASSERT_GE(samples.size(), 5u);
  EXPECT_GE(samples[0]->stamp.lost_before, 30u);
  EXPECT_EQ(samples.back()->stamp.lost_before, 0u);
  EXPECT_EQ(source_.health().reconnects, 1u);
}

TEST_F(ModbusSourceTest, StopDoesNotWaitForTheNextInstant) {
  Device device(bank_);
  start(config(device.port(), "", seconds(3600)));
  // It has read at t0 and waits for the next instant, an hour away: a stop that waited for it would never
  // return.
  ASSERT_TRUE(eventually(seconds(20), [&] { return !bank_->reads().empty(); }));
  ASSERT_TRUE(source_.stop());
}

TEST_F(ModbusSourceTest, SaysWhatIsWrongAtArm) {
  std::uint16_t nobody = 0;
  {
    const Device gone(bank_);
    nobody = gone.port();
  }
  ASSERT_TRUE(source_.configure(config(nobody)));
  auto s = source_.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  EXPECT_EQ(s.error().exit_status(), 2);
  EXPECT_EQ(s.error().text(),
            "table: 127.0.0.1:" + std::to_string(nobody) +
                ": expected a Modbus TCP device that listens here, got: Connection refused; check that it is "
                "on and "
                "that `address` and `port` are its own, or start an emulated one with `rigor "
                "emulate`");
  EXPECT_EQ(source_.state(), ChannelState::configured);

  Device device(bank_);
  auto c = config(device.port());
  c.params = yaml("address: 127.0.0.1\nport: " + std::to_string(device.port()) +
                  "\nregisters: [{ name: a, table: input_registers, address: 300 }]\n");
  ASSERT_TRUE(source_.configure(c));
  s = source_.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_NE(s.error().text().find("input_registers 300 to 300: Illegal data address"), std::string::npos)
      << s.error().text();
}

TEST_F(ModbusSourceTest, NeedsARate) {
  auto c = config(5020);
  c.period = {};
  const auto s = source_.configure(c);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("expected a rate_hz above 0"), std::string::npos);
}

}  // namespace
}  // namespace rigor::modbus
