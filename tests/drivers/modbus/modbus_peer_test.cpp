// Other people's programs on our traffic: mbpoll as master, and tshark's dissectors over what was on the
// wire.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>

#include "drivers/modbus/modbus_source.h"
#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

bool installed(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0;
}
struct Said {
  int status = -1;
  std::string text;
};
Said say(const std::string& command) {
  Said s;
  FILE* p = ::popen((command + " 2>&1").c_str(), "r");
  if (p == nullptr) return s;
  char b[512];
  while (const auto n = std::fread(b, 1, sizeof b, p)) s.text.append(b, n);
  s.status = WEXITSTATUS(::pclose(p));
  return s;
}
std::string temporary(const std::string& name) {
  return (std::filesystem::temp_directory_path() / ("rigor-" + std::to_string(::getpid()) + "-" + name))
      .string();
}

/// mbpoll reads and writes all four tables of the device that `where` names.
void poll_all_tables(const std::string& mode, const std::string& where, Bank& bank) {
  bank.set(RegisterTable::input_registers, 4, {1111, 2222, 3333});
  bank.set(RegisterTable::discrete_inputs, 2, {1, 0, 1});
  const auto poll = [&](const std::string& what, const std::string& values = "") {
    const auto s = say("mbpoll " + mode + " -0 -1 -q -o 5 " + what + " " + where + " " + values);
    EXPECT_EQ(s.status, 0) << s.text;
    return s.text;
  };
  // mbpoll: 0 coils, 1 discrete inputs, 3 input registers, 4 holding registers.
  auto text = poll("-t 3 -r 4 -c 3");
  EXPECT_NE(text.find("[4]: \t1111"), std::string::npos) << text;
  EXPECT_NE(text.find("[6]: \t3333"), std::string::npos) << text;
  text = poll("-t 1 -r 2 -c 3");
  EXPECT_NE(text.find("[2]: \t1"), std::string::npos) << text;
  EXPECT_NE(text.find("[3]: \t0"), std::string::npos) << text;
  poll("-t 4 -r 10", "-- 11 22 33");
  EXPECT_EQ(bank.holding(11), 22);
  text = poll("-t 4 -r 10 -c 3");
  EXPECT_NE(text.find("[12]: \t33"), std::string::npos) << text;
  poll("-t 0 -r 7", "-- 1 0 1 1");
  EXPECT_EQ(bank.get(RegisterTable::coils, 10), 1);
  text = poll("-t 0 -r 7 -c 4");
  EXPECT_NE(text.find("[8]: \t0"), std::string::npos) << text;
  const auto refused = say("mbpoll " + mode + " -0 -1 -q -t 4 -r 255 -c 9 " + where);
  EXPECT_NE(refused.text.find("Illegal data address"), std::string::npos) << refused.text;
}

TEST(ModbusPeer, MbpollReadsAndWritesTheTcpEmulator) {
  if (!installed("mbpoll")) GTEST_SKIP() << "mbpoll is not installed";
  auto bank = std::make_shared<Bank>();
  Device device(bank);
  poll_all_tables("-m tcp -p " + std::to_string(device.port()), "127.0.0.1", *bank);
  EXPECT_EQ(device->server()->counters().malformed.load(), 0u);
}

TEST(ModbusPeer, MbpollReadsAndWritesTheRtuEmulator) {
  if (!installed("mbpoll")) GTEST_SKIP() << "mbpoll is not installed";
  auto bank = std::make_shared<Bank>();
  ModbusEmulator device;
  device.attach(parts_of(bank));
  ChannelConfig c;
  c.name = "meter";
  c.params = yaml("transport: rtu\nunit: 5\npty: " + temporary("mbpoll"));
  ASSERT_TRUE(device.configure(c));
  ASSERT_TRUE(device.arm({}));
  ASSERT_TRUE(device.start(bench_now()));
  poll_all_tables("-m rtu -a 5 -b 19200 -P none", device.device(), *bank);
  EXPECT_EQ(device.server()->counters().malformed.load(), 0u);
}

TEST(ModbusPeer, TsharkFindsNothingMalformedInOurTraffic) {
  if (!installed("tshark")) GTEST_SKIP() << "tshark is not installed";
  auto bank = std::make_shared<Bank>();
  Device device(bank);
  const auto file = temporary("modbus.pcapng"), log = temporary("tshark.log");
  const std::string port = std::to_string(device.port());
  const pid_t tshark = ::fork();
  if (tshark == 0) {
    if (std::freopen(log.c_str(), "w", stderr) == nullptr ||
        std::freopen("/dev/null", "w", stdout) == nullptr)
      ::_exit(1);
    ::execlp("tshark", "tshark", "-i", "lo", "-f", ("tcp port " + port).c_str(), "-w", file.c_str(), nullptr);
    ::_exit(127);
  }
  bool gone = false;
  const bool ready = eventually(seconds(20), [&] {
    gone = gone || ::waitpid(tshark, nullptr, WNOHANG) == tshark;
    return gone || say("cat " + log).text.find("Capturing on") != std::string::npos;
  });
  if (gone || !ready) {
    if (!gone) ::kill(tshark, SIGTERM), ::waitpid(tshark, nullptr, 0);
    GTEST_SKIP() << "tshark may not capture on lo here: " << say("cat " + log).text;
  }
  std::this_thread::sleep_for(
      std::chrono::milliseconds(300));  // "Capturing on" comes before the socket is open
  {
    ModbusSource source;
    ChannelConfig c;
    c.name = "s";
    c.period = milliseconds(10);
    c.params = yaml("address: 127.0.0.1\nport: " + port +
                    "\nmax_gap: 120\nregisters:\n"
                    "  - { name: a, table: input_registers, address: 0, type: f64 }\n"
                    "  - { name: b, table: input_registers, address: 121, type: f64 }\n"
                    "  - { name: c, table: coils, address: 3 }\n"
                    "  - { name: d, table: discrete_inputs, address: 3 }\n"
                    "  - { name: e, table: holding_registers, address: 3, bits: [3, 4] }\n");
    ASSERT_TRUE(source.configure(c));
    ASSERT_TRUE(source.arm({}));
    ASSERT_TRUE(source.start(bench_now()));
    EXPECT_TRUE(eventually(seconds(20), [&] { return source.health().received >= 20; }));
    device->set_faults({.exception_every = 3});
    EXPECT_TRUE(eventually(seconds(20), [&] { return source.health().protocol_errors >= 5; }));
    device->set_faults({});
    Link link;
    ASSERT_TRUE(link.open({.port = device.port(), .serial = {}}));
    const std::vector<std::uint16_t> values(100, 1);
    EXPECT_EQ(link.write({RegisterTable::holding_registers, 0, 100, 0}, values), LinkStatus::good);
    EXPECT_EQ(link.write({RegisterTable::holding_registers, 0, 1, 0}, values), LinkStatus::good);
    EXPECT_EQ(link.write({RegisterTable::holding_registers, 0, 1, 0, 1, 0xF}, values), LinkStatus::good);
    EXPECT_EQ(link.write({RegisterTable::coils, 0, 100, 0}, values), LinkStatus::good);
    EXPECT_EQ(link.write({RegisterTable::coils, 0, 1, 0}, values), LinkStatus::good);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));  // dumpcap hands packets on once a second
  ::kill(tshark, SIGINT);
  ::waitpid(tshark, nullptr, 0);
  const auto count = [&](const std::string& filter) {
    const auto s =
        say("tshark -r " + file + " -o mbtcp.tcp.port:" + port + " -Y '" + filter + "' 2>/dev/null | wc -l");
    return std::atoi(s.text.c_str());
  };
  EXPECT_GE(count("mbtcp"), 100);
  EXPECT_GE(count("modbus.exception_code"), 5);
  EXPECT_EQ(count("_ws.malformed || mbtcp.prot_id != 0 || tcp.analysis.lost_segment"), 0);
  EXPECT_EQ(count("modbus && _ws.expert.severity >= 0x00600000 && !modbus.exception_code"), 0)
      << say("tshark -r " + file + " -o mbtcp.tcp.port:" + port + " -Y '_ws.expert' -V | tail -40").text;
  std::filesystem::remove(file);
  std::filesystem::remove(log);
}

}  // namespace
}  // namespace rigor::modbus
