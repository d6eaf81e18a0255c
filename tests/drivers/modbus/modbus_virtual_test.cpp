// The device of virtual time: exact instants, one order of events, and the same answer every time.
#include "drivers/modbus/modbus_backend.h"
#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

constexpr const char* kSource =
    "address: 127.0.0.1\nregisters:\n"
    "  - { name: now_ms, table: input_registers, address: 0, type: u32 }\n"
    "  - { name: echo, table: holding_registers, address: 4, type: s32, scale: 0.001 }\n";
constexpr const char* kSink =
    "address: 127.0.0.1\nregisters:\n"
    "  - { name: target, table: holding_registers, address: 4, type: s32, scale: 0.001 }\n"
    "safe: { target: 0 }\n";

/// A rig of one device, two sources and two sinks, run cycle by cycle.
struct Rig {
  explicit Rig(Duration latency = milliseconds(10), Duration command_latency = milliseconds(7)) {
    bank->on_read([](BenchTime at, Bank::Tables& tables) {
      const auto ms = static_cast<std::uint32_t>(at.ns() / 1000000);
      tables[2][0] = static_cast<std::uint16_t>(ms >> 16);
      tables[2][1] = static_cast<std::uint16_t>(ms);
    });
    const auto backend = modbus_backend();
    for (int i = 0; i < 2; ++i) {
      auto s = backend.make_virtual_source(modbus::parts_of(bank), {});
      EXPECT_TRUE(s.has_value());
      ChannelConfig c;
      c.name = "source" + std::to_string(i);
      c.kind = SampleKind::register_block;
      c.period = milliseconds(i == 0 ? 10 : 5);
      c.latency = latency;
      c.params = yaml(kSource);
      auto ok = (*s)->configure(c);
      EXPECT_TRUE(ok) << ok.error().text();
      sources.push_back(std::move(*s));
      auto k = backend.make_virtual_sink(modbus::parts_of(bank), {});
      EXPECT_TRUE(k.has_value());
      c.name = "sink" + std::to_string(i);
      c.latency = command_latency;
      c.params = yaml(kSink);
      ok = (*k)->configure(c);
      EXPECT_TRUE(ok) << ok.error().text();
      sinks.push_back(std::move(*k));
    }
    for_all([](Channel& c) {
      const auto s = c.arm({.virtual_time = true});
      EXPECT_TRUE(s) << s.error().text();
    });
    for_all([](Channel& c) { EXPECT_TRUE(c.start(BenchTime(0))); });
  }
  template <class F>
  void for_all(F&& f) {
    for (auto& s : sources) f(*s);
    for (auto& s : sinks) f(*s);
  }
  /// Runs to `end`; `each` is the application. What was seen is written down.
  template <class F>
  std::string run(Duration end, F&& each) {
    std::string log;
    for (; t <= BenchTime(0) + end; t = t + milliseconds(1)) {
      for (auto& s : sinks) s->complete_until(t);
      for (std::size_t i = 0; i < sources.size(); ++i) {
        sources[i]->complete_until(t);
        while (auto s = sources[i]->poll(t)) {
          const auto* b = s->as<RegisterBlock>();
          log += std::to_string(t.ns() / 1000000) + " " + std::to_string(i) + " #" +
                 std::to_string(s->stamp.sequence) + " t=" + std::to_string(s->stamp.t_capture.ns()) +
                 " now=" + std::to_string(b->value[0]) + " echo=" + std::to_string(b->value[1]) + "\n";
          last[i] = *b;
        }
      }
      each(t);
    }
    return log;
  }
  bool command(std::size_t sink, double value, Duration in) {
    Command c;
    c.t_issue = t;
    c.t_effect = t + in;
    c.count = 1;
    c.value[0] = value;
    return sinks[sink]->command(c);
  }
  std::shared_ptr<Bank> bank = std::make_shared<Bank>();
  std::vector<std::unique_ptr<Source>> sources;
  std::vector<std::unique_ptr<Sink>> sinks;
  std::array<RegisterBlock, 2> last{};
  BenchTime t{0};
};

TEST(ModbusVirtual, ReadsAtTheInstantOfTheCapture) {
  Rig rig;
  const auto log = rig.run(milliseconds(100), [](BenchTime) {});
  EXPECT_NE(log.find("60 0 #5 t=50000000 now=50.000000"), std::string::npos) << log;
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 10 + 19) << log;
  EXPECT_EQ(rig.sources[0]->health().lost, 0u);
}

TEST(ModbusVirtual, WritesAtTheInstantOfTheEffect) {
  Rig rig;
  (void)rig.run(milliseconds(50), [&](BenchTime t) {
    if (t == BenchTime(0) + milliseconds(12)) {
      ASSERT_TRUE(rig.command(0, 1.5, microseconds(7300)));
    }
  });
  std::vector<Bank::Write> commands;
  for (const auto& w : rig.bank->writes())
    if (w.values != std::vector<std::uint16_t>{0, 0}) commands.push_back(w);
  ASSERT_EQ(commands.size(), 1u);
  EXPECT_EQ(commands[0].t, BenchTime(0) + microseconds(19300));
  EXPECT_EQ(commands[0].values, (std::vector<std::uint16_t>{0, 1500}));
}

TEST(ModbusVirtual, AtOneInstantCommandsComeBeforeReads) {
  Rig rig;
  const auto log = rig.run(milliseconds(60), [&](BenchTime t) {
    // Takes effect at 20 ms sharp, where both sources read; and just after 30 ms.
    if (t == BenchTime(0) + milliseconds(13)) {
      ASSERT_TRUE(rig.command(0, 2, milliseconds(7)));
      ASSERT_TRUE(rig.command(1, 3, milliseconds(17) + nanoseconds(1)));
    }
  });
  EXPECT_NE(log.find("t=15000000 now=15.000000 echo=0.0"), std::string::npos) << log;
  EXPECT_NE(log.find("0 #2 t=20000000 now=20.000000 echo=2.0"), std::string::npos) << log;
  EXPECT_NE(log.find("1 #4 t=20000000 now=20.000000 echo=2.0"), std::string::npos) << log;
  EXPECT_NE(log.find("0 #3 t=30000000 now=30.000000 echo=2.0"), std::string::npos) << log;
  EXPECT_NE(log.find("1 #7 t=35000000 now=35.000000 echo=3.0"), std::string::npos) << log;
}

TEST(ModbusVirtual, ACommandOfTheSameCycleIsInTimeForItsRead) {
  Rig rig(milliseconds(10), Duration(0));
  const auto log = rig.run(milliseconds(60), [&](BenchTime t) {
    if (t == BenchTime(0) + milliseconds(20)) {
      ASSERT_TRUE(rig.command(0, 5, Duration(0)));
    }
  });
  EXPECT_NE(log.find("0 #2 t=20000000 now=20.000000 echo=5.0"), std::string::npos) << log;
}

TEST(ModbusVirtual, TheModelNeverSeesTimeRunBack) {
  Rig rig(milliseconds(40), milliseconds(1));
  (void)rig.run(milliseconds(300), [&](BenchTime t) {
    (void)rig.command(t.ns() / 1'000'000 % 2, static_cast<double>(t.ns() % 97), milliseconds(1));
  });
  BenchTime before(-1);
  for (const auto r : rig.bank->reads()) {
    EXPECT_GE(r, before);
    before = r;
  }
  before = BenchTime(-1);
  for (const auto& w : rig.bank->writes()) {
    EXPECT_GE(w.t, before);
    before = w.t;
  }
}

TEST(ModbusVirtual, WorksWithoutLatency) {
  Rig rig(Duration(0), Duration(0));
  const auto log = rig.run(milliseconds(30), [&](BenchTime t) {
    if (t == BenchTime(0) + milliseconds(9)) {
      ASSERT_TRUE(rig.command(0, 4, milliseconds(1)));
    }
  });
  EXPECT_NE(log.find("10 0 #1 t=10000000 now=10.000000 echo=4.0"), std::string::npos) << log;
}

TEST(ModbusVirtual, TheSameRunGivesTheSameLog) {
  const auto once = [] {
    Rig rig;
    std::uint64_t x = 1;
    return rig.run(milliseconds(500), [&](BenchTime) {
      x = x * 6364136223846793005u + 1442695040888963407u;
      if (x >> 62 == 0)
        (void)rig.command(x >> 61 & 1, static_cast<double>(x >> 50), microseconds(500 + (x >> 53)));
    });
  };
  const auto first = once();
  EXPECT_GT(first.size(), 1000u);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(once(), first);
}

TEST(ModbusVirtual, IsSafeAfterStop) {
  Rig rig;
  (void)rig.run(milliseconds(20), [&](BenchTime) { (void)rig.command(0, 9, milliseconds(1)); });
  EXPECT_EQ(rig.bank->holding(5), 9000);
  rig.for_all([](Channel& c) { EXPECT_TRUE(c.stop()); });
  EXPECT_EQ(rig.bank->holding(5), 0);
}

TEST(ModbusVirtual, RefusesRegistersThatTheModelDoesNotHave) {
  const auto backend = modbus_backend();
  auto s = backend.make_virtual_source(modbus::parts_of(std::make_shared<Bank>()), {});
  ASSERT_TRUE(s.has_value());
  ChannelConfig c;
  c.name = "s";
  c.period = milliseconds(1);
  c.params = yaml("address: a\nregisters: [{ name: a, table: coils, address: 999 }]\n");
  ASSERT_TRUE((*s)->configure(c));
  EXPECT_EQ((*s)->arm({.virtual_time = true}).error().code, ErrorCode::bad_input);
  EXPECT_FALSE(backend.make_virtual_source({}, {}).has_value());
}

}  // namespace
}  // namespace rigor::modbus
