// Serial lines: the emulated device on a pseudo-terminal, and two pairs with a relay between them, as a cable
// with two adapters is one.
#include <fcntl.h>
#include <modbus/modbus.h>
#include <poll.h>
#include <pty.h>
#include <termios.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>

#include "drivers/modbus/modbus_sink.h"
#include "drivers/modbus/modbus_source.h"
#include "tests/drivers/modbus/modbus_test_tools.h"
#include "tests/paths.h"

namespace rigor::modbus {
namespace {

std::string link_path(const std::string& name) {
  return (std::filesystem::temp_directory_path() / ("rigor-" + std::to_string(::getpid()) + "-" + name))
      .string();
}

/// An emulated device on a serial line, by the keys that a rig has.
class LineDevice {
 public:
  LineDevice(std::shared_ptr<RegisterModel> model, const std::string& keys) {
    emulator_.attach(parts_of(std::move(model)));
    ChannelConfig c;
    c.name = "meter";
    c.params = yaml("transport: rtu\nbaud: 115200\n" + keys);
    auto s = emulator_.configure(c);
    EXPECT_TRUE(s) << s.error().text();
    s = emulator_.arm({});
    EXPECT_TRUE(s) << s.error().text();
    s = emulator_.start(bench_now());
    EXPECT_TRUE(s) << s.error().text();
  }
  ModbusEmulator* operator->() { return &emulator_; }

 private:
  ModbusEmulator emulator_;
};

/// Two pseudo-terminals and a cable between them, on which bytes can be spoilt.
class Cable {
 public:
  Cable() {
    for (auto& e : end_) {
      char name[128];
      EXPECT_EQ(::openpty(&e.near, &e.far, name, nullptr, nullptr), 0);
      e.name = name;
      termios t{};
      ::tcgetattr(e.far, &t);
      ::cfmakeraw(&t);
      ::tcsetattr(e.far, TCSANOW, &t);
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Cable() {
    done_ = true;
    thread_.join();
    for (auto& e : end_) ::close(e.near), ::close(e.far);
  }
  [[nodiscard]] const std::string& name(int i) const { return end_[i].name; }
  std::atomic<int> spoil{0};  ///< so many lumps get a wrong bit

 private:
  void run() {
    while (!done_) {
      pollfd fds[2]{{end_[0].near, POLLIN, 0}, {end_[1].near, POLLIN, 0}};
      if (::poll(fds, 2, 20) <= 0) continue;
      for (int i = 0; i < 2; ++i) {
        if ((fds[i].revents & POLLIN) == 0) continue;
        std::uint8_t b[256];
        const auto n = ::read(end_[i].near, b, sizeof b);
        if (n <= 0) continue;
        if (spoil > 0) --spoil, b[n - 1] ^= 0x10;
        EXPECT_EQ(::write(end_[1 - i].near, b, static_cast<std::size_t>(n)), n);
      }
    }
  }
  struct End {
    int near = -1, far = -1;
    std::string name;
  } end_[2];
  std::atomic<bool> done_{false};
  std::thread thread_;
};

struct Master {
  Master(const std::string& device, int unit) : m(modbus_new_rtu(device.c_str(), 115200, 'E', 8, 1)) {
    modbus_set_slave(m, unit);
    modbus_set_response_timeout(m, 5, 0);
    EXPECT_EQ(modbus_connect(m), 0) << modbus_strerror(errno);
  }
  ~Master() {
    modbus_close(m);
    modbus_free(m);
  }
  modbus_t* m;
};

constexpr const char* kLine = "transport: rtu\nbaud: 115200\n";

ChannelConfig source_config(const std::string& device, const std::string& more = "") {
  ChannelConfig c;
  c.name = "meter";
  c.kind = SampleKind::register_block;
  c.period = milliseconds(25);
  c.latency = milliseconds(5);
  c.params = yaml(kLine + ("device: " + device + "\n") + more +
                  "registers:\n"
                  "  - { name: a, table: input_registers, address: 0, type: s32 }\n"
                  "  - { name: b, table: discrete_inputs, address: 9 }\n"
                  "  - { name: c, table: coils, address: 4 }\n"
                  "  - { name: d, table: holding_registers, address: 20, type: f32, byte_order: CDAB }\n");
  return c;
}

TEST(ModbusRtu, AMasterReadsAndWritesAllTablesOfTheEmulator) {
  auto bank = std::make_shared<Bank>();
  LineDevice device(bank, "unit: 17\npty: " + link_path("tables") + "\n");
  EXPECT_EQ(device->endpoint(), "Modbus RTU device meter unit 17 at " + link_path("tables"));
  bank->set(RegisterTable::input_registers, 3, {0xBEEF});
  bank->set(RegisterTable::discrete_inputs, 8, {1, 0, 1});
  Master master(device->device(), 17);
  std::uint16_t r[125];
  std::uint8_t bits[8];
  ASSERT_EQ(modbus_read_input_registers(master.m, 3, 1, r), 1) << modbus_strerror(errno);
  EXPECT_EQ(r[0], 0xBEEF);
  ASSERT_EQ(modbus_read_input_bits(master.m, 8, 3, bits), 3);
  EXPECT_EQ(bits[2], 1);
  ASSERT_EQ(modbus_write_bit(master.m, 5, 1), 1);
  ASSERT_EQ(modbus_read_bits(master.m, 4, 3, bits), 3);
  EXPECT_EQ(bits[1], 1);
  std::uint16_t many[100];
  for (std::uint16_t i = 0; i < 100; ++i) many[i] = static_cast<std::uint16_t>(7 * i);
  ASSERT_EQ(modbus_write_registers(master.m, 10, 100, many), 100);
  ASSERT_EQ(modbus_read_registers(master.m, 10, 100, r), 100);
  EXPECT_EQ(r[99], 693);
  ASSERT_EQ(modbus_read_registers(master.m, 250, 10, r), -1);
  EXPECT_EQ(errno, EMBXILADD);
  EXPECT_EQ(device->server()->counters().malformed.load(), 0u);
  EXPECT_TRUE(device->health().connected);
}

TEST(ModbusRtu, OtherUnitsAreNotAnsweredAndBroadcastsAreCarriedOut) {
  auto bank = std::make_shared<Bank>();
  LineDevice device(bank, "unit: 3\npty: " + link_path("units") + "\n");
  const int fd = ::open(device->device().c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK);
  ASSERT_GE(fd, 0);
  const auto say = [&](std::vector<std::uint8_t> frame) {
    frame.resize(frame.size() + 2);
    (void)seal_frame(frame, frame.size() - 2);
    ASSERT_EQ(::write(fd, frame.data(), frame.size()), static_cast<ssize_t>(frame.size()));
  };
  const auto& n = device->server()->counters();
  say({9, 6, 0, 1, 0, 77});  // unit 9
  EXPECT_TRUE(eventually(seconds(20), [&] { return n.other_units.load() == 1; }));
  say({0, 6, 0, 2, 0, 78});  // everyone
  EXPECT_TRUE(eventually(seconds(20), [&] { return bank->holding(2) == 78; }));
  EXPECT_EQ(bank->holding(1), 0);
  say({0, 3, 0, 2, 0, 1});  // nobody reads for everyone
  EXPECT_TRUE(eventually(seconds(20), [&] { return n.broadcasts.load() == 2; }));
  const std::uint8_t noise[] = {0xFF, 0x00, 0x12, 0x99, 0x41};
  ASSERT_EQ(::write(fd, noise, sizeof noise), 5);
  EXPECT_TRUE(eventually(seconds(20), [&] { return n.malformed.load() == 1; }));
  std::uint8_t b[16];
  EXPECT_LE(::read(fd, b, sizeof b), 0) << "something was answered";
  say({3, 3, 0, 2, 0, 1});
  std::vector<std::uint8_t> answer;
  EXPECT_TRUE(eventually(seconds(20), [&] {
    const auto got = ::read(fd, b, sizeof b);
    if (got > 0) answer.insert(answer.end(), b, b + got);
    return answer.size() >= 7;
  }));
  EXPECT_EQ(std::vector<std::uint8_t>(answer.begin(), answer.begin() + 5),
            (std::vector<std::uint8_t>{3, 3, 2, 0, 78}));
  ::close(fd);
}

TEST(ModbusRtu, SourceAndSinkShareALine) {
  auto bank = std::make_shared<Bank>();
  bank->set(RegisterTable::input_registers, 0, {0xFFFF, 0xFFFE});
  bank->set(RegisterTable::discrete_inputs, 9, {1});
  LineDevice device(bank, "pty: " + link_path("shared") + "\n");
  ModbusSource source;
  ModbusSink sink;
  auto s = source.configure(source_config(device->device()));
  ASSERT_TRUE(s) << s.error().text();
  ChannelConfig c;
  c.name = "valve";
  c.params = yaml(kLine + ("device: " + device->device() + "\n") +
                  "verify: true\nregisters:\n"
                  "  - { name: open, table: coils, address: 4 }\n"
                  "  - { name: level, table: holding_registers, address: 20, type: f32, byte_order: CDAB }\n"
                  "safe: { open: 0, level: 0.5 }\n");
  s = sink.configure(c);
  ASSERT_TRUE(s) << s.error().text();
  s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  s = sink.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  ASSERT_TRUE(sink.start(bench_now()));
  RegisterBlock last;
  const auto seen = [&](double open, double level) {
    return eventually(seconds(20), [&] {
      while (auto x = source.poll(bench_now())) last = *x->as<RegisterBlock>();
      return last.count == 4 && last.value[2] == open && last.value[3] == level;
    });
  };
  EXPECT_TRUE(seen(0, 0.5)) << "the safe values of arm";
  EXPECT_EQ(last.value[0], -2);
  EXPECT_EQ(last.value[1], 1);
  for (int i = 1; i <= 10; ++i) {
    Command command;
    command.t_issue = command.t_effect = bench_now();
    command.count = 2;
    command.value[0] = i % 2;
    command.value[1] = i * 0.25;
    ASSERT_TRUE(sink.command(command));
    EXPECT_TRUE(seen(i % 2, i * 0.25)) << i;
  }
  // The source may see the last values before the sink has read them back.
  EXPECT_TRUE(eventually(seconds(20), [&] { return sink.counters().applied == 10; }));
  EXPECT_EQ(sink.counters().failed, 0u);
  EXPECT_EQ(source.health().protocol_errors, 0u);
  EXPECT_EQ(source.link_counters().trouble(), "");
  EXPECT_EQ(device->server()->counters().malformed.load(), 0u);
}

TEST(ModbusRtu, ASpoiltByteIsAskedForAgain) {
  Cable cable;
  auto bank = std::make_shared<Bank>();
  LineDevice device(bank, "device: " + cable.name(0) + "\n");
  ModbusSource source;
  ASSERT_TRUE(source.configure(source_config(cable.name(1), "timeout_ms: 300\nretries: 3\n")));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::uint64_t got = 0;
  const auto take = [&] {
    while (source.poll(bench_now())) ++got;
    return got;
  };
  EXPECT_TRUE(eventually(seconds(20), [&] { return take() >= 3; }));
  cable.spoil = 2;
  EXPECT_TRUE(eventually(seconds(20), [&] { return take(), source.health().retries >= 1; }));
  const auto before = got;
  EXPECT_TRUE(eventually(seconds(20), [&] { return take() > before + 2; }));
  EXPECT_GE(source.link_counters().broken.load() + source.link_counters().timeouts.load(), 1u);
  ASSERT_EQ(source.warnings().size(), 1u);
  EXPECT_NE(source.warnings()[0].find("at " + cable.name(1)), std::string::npos) << source.warnings()[0];
}

TEST(ModbusRtu, ReturnsWhenTheDeviceIsPluggedInAgain) {
  auto bank = std::make_shared<Bank>();
  const auto path = link_path("again");
  auto device = std::make_unique<LineDevice>(bank, "pty: " + path + "\n");
  ModbusSource source;
  ASSERT_TRUE(source.configure(source_config(path, "timeout_ms: 200\n")));
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<Stamp> stamps;
  const auto take = [&] {
    while (auto x = source.poll(bench_now())) stamps.push_back(x->stamp);
    return stamps.size();
  };
  EXPECT_TRUE(eventually(seconds(20), [&] { return take() >= 3; }));
  device.reset();
  EXPECT_FALSE(std::filesystem::exists(path)) << "the link outlived the device";
  EXPECT_TRUE(eventually(seconds(20), [&] { return !source.health().connected; }));
  device = std::make_unique<LineDevice>(bank, "pty: " + path + "\n");
  const auto before = take();
  EXPECT_TRUE(eventually(seconds(20), [&] { return take() >= before + 3; }));
  std::uint64_t missing = 0, told = 0;
  for (std::size_t i = 1; i < stamps.size(); ++i) {
    missing += stamps[i].sequence - stamps[i - 1].sequence - 1;
    told += stamps[i].lost_before;
  }
  EXPECT_GT(missing, 0u);
  EXPECT_EQ(missing, told);
  EXPECT_GE(source.health().reconnects, 1u);
}

TEST(ModbusRtu, SaysWhatIsWrongWithAPort) {
  ModbusSource source;
  ASSERT_TRUE(source.configure(source_config("/dev/no-such-port")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  EXPECT_NE(s.error().text().find("/dev/no-such-port (115200 8E1)"), std::string::npos) << s.error().text();
  EXPECT_NE(s.error().text().find("plugged in"), std::string::npos) << s.error().text();
  const auto refused = [](const std::string& keys) {
    ModbusEmulator e;
    ChannelConfig c;
    c.name = "meter";
    c.params = yaml("transport: rtu\n" + keys);
    const auto r = e.configure(c);
    return r ? std::string() : r.error().text();
  };
  EXPECT_NE(refused("baud: 12345\npty: /tmp/x\n").find("expected one of 1200, "), std::string::npos);
  EXPECT_NE(refused("unit: 1\n").find("expected either `pty`"), std::string::npos) << refused("unit: 1\n");
  EXPECT_NE(refused("pty: /tmp/x\nunit: 248\n").find("from 1 to 247"), std::string::npos);
  // A file of somebody's is not replaced.
  ModbusEmulator e;
  e.attach(parts_of(std::make_shared<Bank>()));
  ChannelConfig c;
  c.name = "meter";
  c.params = yaml("transport: rtu\npty: " + rigor::test::source_dir() + "/README.md\n");
  ASSERT_TRUE(e.configure(c));
  EXPECT_NE(e.arm({}).error().text().find("give another `pty`"), std::string::npos);
}

}  // namespace
}  // namespace rigor::modbus
