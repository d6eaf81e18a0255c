// What is asked for in one go and how often; fields of registers; what a device that refuses leaves behind; a
// device of plain registers; and faults that are the same in each virtual run.
#include <map>

#include "drivers/modbus/modbus_backend.h"
#include "drivers/modbus/modbus_sink.h"
#include "drivers/modbus/modbus_source.h"
#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

RegisterMap map_of(const std::string& keys, RegisterMap::Access access = RegisterMap::Access::read) {
  auto m = catch_config([&] { return RegisterMap::parse(yaml(keys), "registers", access, 64); });
  EXPECT_TRUE(m.has_value()) << (m ? "" : m.error().text());
  return m ? *m : RegisterMap();
}
std::string refusal(const std::string& keys, RegisterMap::Access access = RegisterMap::Access::read) {
  auto m = catch_config([&] { return RegisterMap::parse(yaml(keys), "registers", access, 64); });
  return m ? "" : m.error().text();
}
std::string shape(const RegisterMap& m) {
  std::string s;
  for (const auto& r : m.requests())
    s += (s.empty() ? "" : " ") + std::to_string(r.address) + "+" + std::to_string(r.count) +
         (r.every > 1 ? "/" + std::to_string(r.every) : "");
  return s;
}

TEST(ModbusPolling, GapsAreReadWhereTheRigAllowsThem) {
  const std::string registers =
      "registers:\n"
      "  - { name: a, table: input_registers, address: 0 }\n"
      "  - { name: b, table: input_registers, address: 5, type: u32 }\n"
      "  - { name: c, table: input_registers, address: 20 }\n";
  EXPECT_EQ(shape(map_of(registers)), "0+1 5+2 20+1");
  EXPECT_EQ(shape(map_of("max_gap: 4\n" + registers)), "0+7 20+1");
  EXPECT_EQ(shape(map_of("max_gap: 13\n" + registers)), "0+21");
  EXPECT_EQ(
      shape(map_of("{max_gap: 13, max_registers: 10, " + registers.substr(0, 0) +
                   "registers: [{ name: a, table: input_registers, address: 0 }, { name: b, table: "
                   "input_registers, address: 9 }, { name: c, table: input_registers, address: 10 }]}")),
      "0+10 10+1");
  // No value is torn, and no request is longer than the protocol's 125 registers.
  std::string many = "max_gap: 100\nregisters:\n";
  for (int i = 0; i < 60; ++i)
    many += "  - { name: r" + std::to_string(i) +
            ", table: holding_registers, address: " + std::to_string(4 * i) + ", type: f64 }\n";
  EXPECT_EQ(shape(map_of(many)), "0+124 124+116");
  EXPECT_NE(
      refusal("max_registers: 1\nregisters: [{ name: a, table: input_registers, address: 0, type: u32 }]")
          .find("expected at most the 1 registers"),
      std::string::npos);
}

TEST(ModbusPolling, ReadsEachValueAsOftenAsTheRigSays) {
  EXPECT_EQ(shape(map_of("registers:\n"
                         "  - { name: a, table: input_registers, address: 0 }\n"
                         "  - { name: slow, table: input_registers, address: 1, every: 10 }\n"
                         "  - { name: b, table: input_registers, address: 2 }\n")),
            "0+1 2+1 1+1/10");
  auto bank = std::make_shared<Bank>();
  bank->set(RegisterTable::input_registers, 0, {11});
  bank->set(RegisterTable::holding_registers, 0, {22});
  std::map<int, int> asked;
  bank->on_read([&](BenchTime, Bank::Tables& t) { ++t[2][0], ++t[3][0]; });  // each request moves both
  Device device(bank);
  ModbusSource source;
  ChannelConfig c;
  c.name = "s";
  c.period = milliseconds(5);
  c.params = yaml("address: 127.0.0.1\nport: " + std::to_string(device.port()) +
                  "\nregisters:\n"
                  "  - { name: fast, table: input_registers, address: 0 }\n"
                  "  - { name: slow, table: holding_registers, address: 0, every: 4 }\n");
  ASSERT_TRUE(source.configure(c));
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<std::pair<std::uint64_t, RegisterBlock>> seen;
  EXPECT_TRUE(eventually(seconds(20), [&] {
    while (auto x = source.poll(bench_now())) seen.emplace_back(x->stamp.sequence, *x->as<RegisterBlock>());
    return seen.size() >= 20;
  }));
  int changes = 0;
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_NE(seen[i].second.value[0], seen[i - 1].second.value[0]);
    const bool changed = seen[i].second.value[1] != seen[i - 1].second.value[1];
    changes += changed;
    // An instant that is due, or the first answer after one that was lost.
    bool due = false;
    for (auto k = seen[i - 1].first + 1; k <= seen[i].first; ++k) due |= k % 4 == 0;
    EXPECT_EQ(changed, due) << seen[i].first;
  }
  EXPECT_GE(changes, 3);
}

TEST(ModbusPolling, FieldsOfARegisterAreReadAndWrittenByThemselves) {
  const std::string fields =
      "registers:\n"
      "  - { name: on, table: holding_registers, address: 7, type: bool, bit: 0 }\n"
      "  - { name: mode, table: holding_registers, address: 7, bits: [4, 3] }\n"
      "  - { name: level, table: holding_registers, address: 8, bits: [8, 8], scale: 0.5, offset: -10 }\n";
  const auto read = map_of(fields);
  EXPECT_EQ(shape(read), "7+2");
  const std::uint16_t raw[] = {0xFF5F, 0x50FF};
  double out[3];
  EXPECT_EQ(read.decode(raw, out), 0u);
  EXPECT_EQ(out[0], 1);
  EXPECT_EQ(out[1], 5);
  EXPECT_EQ(out[2], 30);

  auto bank = std::make_shared<Bank>();
  bank->set(RegisterTable::holding_registers, 7, {0xA5A5, 0x1234});
  Device device(bank);
  ModbusSink sink;
  ChannelConfig c;
  c.name = "s";
  c.params = yaml("address: 127.0.0.1\nverify: true\nport: " + std::to_string(device.port()) + "\n" + fields +
                  "safe: { on: 0 }\n");
  ASSERT_TRUE(sink.configure(c));
  const auto s = sink.arm({});
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(bank->holding(7), 0xA5A4) << "safe: one bit and nothing else";
  ASSERT_TRUE(sink.start(bench_now()));
  Command command;
  command.t_issue = command.t_effect = bench_now();
  command.count = 3;
  command.value = {1, 3, 20};
  ASSERT_TRUE(sink.command(command));
  EXPECT_TRUE(eventually(seconds(20), [&] { return sink.counters().applied == 1; }));
  EXPECT_EQ(bank->holding(7), 0xA5B5);
  EXPECT_EQ(bank->holding(8), 0x3C34);
  command.value[1] = 8;  // three bits hold 7 at most
  ASSERT_TRUE(sink.command(command));
  EXPECT_TRUE(eventually(seconds(20), [&] { return sink.counters().failed == 1; }));
  EXPECT_EQ(bank->holding(7), 0xA5B5);

  EXPECT_NE(refusal("registers: [{ name: a, table: coils, address: 0, bit: 3 }]").find("one bit each"),
            std::string::npos);
  EXPECT_NE(refusal("registers: [{ name: a, table: input_registers, address: 0, bits: [14, 3] }]")
                .find("expected [first bit, how many]"),
            std::string::npos);
  EXPECT_NE(refusal("registers: [{ name: a, table: holding_registers, address: 0, bits: [0, 4] }, { name: b, "
                    "table: holding_registers, address: 0, bits: [3, 2] }]",
                    RegisterMap::Access::write)
                .find("registers of its own"),
            std::string::npos);
}

TEST(ModbusPolling, ExceptionsAreCountedByCodeAndTold) {
  auto bank = std::make_shared<Bank>();
  Device device(bank);
  ModbusSource source;
  ChannelConfig c;
  c.name = "oven";
  c.period = milliseconds(5);
  c.params = yaml("address: 127.0.0.1\nport: " + std::to_string(device.port()) +
                  "\nregisters: [{ name: a, table: input_registers, address: 0 }]\n");
  ASSERT_TRUE(source.configure(c));
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(bench_now()));
  EXPECT_TRUE(source.warnings().empty());
  const auto count = [&](unsigned code) { return source.link_counters().exceptions[code].load(); };
  device->set_faults({.exception_every = 1, .exception_code = 4});
  EXPECT_TRUE(eventually(seconds(20), [&] { return count(4) >= 3; }));
  device->set_faults({.exception_every = 1, .exception_code = 6});
  EXPECT_TRUE(eventually(seconds(20), [&] { return count(6) >= 3; }));
  EXPECT_GE(source.health().retries, 1u) << "a busy device is asked again";
  device->set_faults({});
  std::vector<EventInfo> events;
  EXPECT_TRUE(eventually(seconds(20), [&] {
    while (auto x = source.poll_event()) events.push_back(*x->as<EventInfo>());
    return events.size() >= 3;
  }));
  ASSERT_EQ(events.size(), 3u);
  EXPECT_EQ(events[0].code, 4u);
  EXPECT_EQ(events[0].value, 1);
  EXPECT_NE(std::string(events[0].text.data()).find("input_registers 0 to 0"), std::string::npos)
      << events[0].text.data();
  EXPECT_EQ(events[1].code, 6u);
  EXPECT_EQ(events[2].code, std::uint32_t{kEventBack});
  ASSERT_EQ(source.warnings().size(), 1u);
  EXPECT_NE(source.warnings()[0].find("exceptions 4 (server device failure)"), std::string::npos)
      << source.warnings()[0];
  EXPECT_NE(source.warnings()[0].find("exceptions 6 (server device busy)"), std::string::npos);
}

TEST(ModbusPolling, AnEmulatorOfPlainRegistersNeedsNoModel) {
  ModbusEmulator emulator;
  ChannelConfig c;
  c.name = "meter";
  c.params = yaml(
      "port: 0\nunit: 9\nregisters:\n"
      "  - { name: power, table: input_registers, address: 4, type: f32, value: 230, wave: { amplitude: 5, "
      "period_s: 0.05 } }\n"
      "  - { name: valve, table: coils, address: 3 }\n"
      "  - { name: alarm, table: discrete_inputs, address: 0, value: 1 }\n"
      "  - { name: target, table: holding_registers, address: 0, type: s16, value: -7 }\n");
  const auto configured = emulator.configure(c);
  ASSERT_TRUE(configured) << configured.error().text();
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(bench_now()));
  Link link;
  Endpoint e{.port = emulator.port(), .serial = {}, .unit = 9, .timeout = seconds(5)};
  ASSERT_TRUE(link.open(e));
  std::uint16_t r[2] = {};
  ASSERT_EQ(link.read({RegisterTable::holding_registers, 0, 1, 0}, r), LinkStatus::good);
  EXPECT_EQ(static_cast<std::int16_t>(r[0]), -7);
  ASSERT_EQ(link.read({RegisterTable::discrete_inputs, 0, 1, 0}, r), LinkStatus::good);
  EXPECT_EQ(r[0], 1);
  const std::uint16_t one[] = {1};
  ASSERT_EQ(link.write({RegisterTable::coils, 3, 1, 0}, one), LinkStatus::good);
  ASSERT_EQ(link.read({RegisterTable::coils, 3, 1, 0}, r), LinkStatus::good);
  EXPECT_EQ(r[0], 1);
  float low = 1e9F, high = 0;
  for (int i = 0; i < 400 && high - low < 5; ++i) {
    ASSERT_EQ(link.read({RegisterTable::input_registers, 4, 2, 0}, r), LinkStatus::good);
    const auto x = std::bit_cast<float>(std::uint32_t{r[0]} << 16 | r[1]);
    EXPECT_GE(x, 225);
    EXPECT_LE(x, 235);
    low = std::min(low, x);
    high = std::max(high, x);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GE(high - low, 5) << "it does not move";
  EXPECT_EQ(link.read({RegisterTable::coils, 4, 1, 0}, r), LinkStatus::exception);
  EXPECT_EQ(link.exception_code(), 2u);
  e.unit = 10;
  ASSERT_TRUE(link.open(e));
  EXPECT_EQ(link.read({RegisterTable::coils, 3, 1, 0}, r), LinkStatus::exception);
  EXPECT_EQ(link.exception_code(), 11u);
  link.close();
}

/// What a virtual run of 200 ms sees of a device that misbehaves, as text.
std::string virtual_log(const std::string& emulator_keys, const std::string& source_keys) {
  const auto backend = modbus_backend();
  auto made = backend.make_virtual_source({}, yaml(emulator_keys));
  EXPECT_TRUE(made.has_value()) << (made ? "" : made.error().text());
  if (!made) return {};
  auto& source = **made;
  ChannelConfig c;
  c.name = "s";
  c.period = milliseconds(10);
  c.latency = milliseconds(3);
  c.params = yaml(source_keys + "registers: [{ name: a, table: input_registers, address: 0, type: f32 }]\n");
  auto s = source.configure(c);
  EXPECT_TRUE(s) << s.error().text();
  s = source.arm({.virtual_time = true});
  if (!s) return s.error().text();
  EXPECT_TRUE(source.start(BenchTime(0)));
  std::string log;
  for (BenchTime t; t <= BenchTime(0) + milliseconds(200); t = t + milliseconds(1)) {
    source.complete_until(t);
    while (auto x = source.poll(t))
      log += "#" + std::to_string(x->stamp.sequence) + " " + std::to_string(x->stamp.t_capture.ns() / 1000) +
             "us +" + std::to_string(x->stamp.lost_before) + " " +
             std::to_string(x->as<RegisterBlock>()->value[0]) + "\n";
  }
  const HealthSnapshot h = source.health();
  log += "lost " + std::to_string(h.lost) + " refused " + std::to_string(h.protocol_errors) + " retries " +
         std::to_string(h.retries) + "\n";
  return log;
}

TEST(ModbusVirtual, FaultsToOrderAreTheSameInEachRun) {
  const std::string bank =
      "registers: [{ name: a, table: input_registers, address: 0, type: f32, value: 1, wave: { amplitude: 1, "
      "period_s: 0.07 } }]\n";
  const std::string rtu = "transport: rtu\ndevice: /dev/ttyUSB0\nunit: 4\ntimeout_ms: 20\n";
  for (const std::string transport : {"", "transport: rtu\npty: /tmp/none\nunit: 4\n"}) {
    const std::string keys =
        transport + "faults: { silent_every: 5, exception_every: 7, response_delay_ms: 4, from_s: 0.05 }\n" +
        bank;
    const auto source = transport.empty() ? std::string("address: a\ntimeout_ms: 20\n") : rtu;
    const auto first = virtual_log(keys, source);
    EXPECT_NE(first.find("#4 40000us +0"), std::string::npos) << first;
    EXPECT_NE(first.find("#6 62000us"), std::string::npos) << "half of the delay is the capture's\n" << first;
    EXPECT_EQ(first.find("lost 0"), std::string::npos) << first;
    EXPECT_EQ(first.find("refused 0"), std::string::npos) << first;
    EXPECT_EQ(first.find("retries 0"), std::string::npos) << first;
    for (int i = 0; i < 3; ++i) EXPECT_EQ(virtual_log(keys, source), first);
  }
  EXPECT_NE(
      virtual_log("transport: rtu\npty: /tmp/none\n" + bank, "address: a\n").find("the same `transport`"),
      std::string::npos);
}

}  // namespace
}  // namespace rigor::modbus
