// Every signal at several instants of a run: the table that it commands is safe afterwards, as the table
// itself says, and the recording is whole.
//
//   RIGOR_SIGNAL_INSTANTS=20 build/release/tests/test_signals     the long form: so many instants
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>

#include <cstdlib>
#include <set>
#include <thread>

#include "sensor-hal/record/mcap_reader.h"
#include "tests/cli/command.h"
#include "tests/cli/modbus_probe.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

constexpr int kFirstPort = 15100;
constexpr int kTables = 34;
constexpr std::uint16_t kEnabledBit = 1, kMovingBit = 2;

void sleep_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

std::uint16_t port_of(int table) { return static_cast<std::uint16_t>(kFirstPort + table); }
std::uint16_t enable_of(int table) { return read_register(port_of(table), 3, 0).value_or(999); }
std::uint16_t status_of(int table) { return read_register(port_of(table), 4, 4).value_or(999); }

/// The script commands every five seconds; what keeps the table's watchdog quiet in between is the sink.
std::string rig_text() {
  std::string text = R"(name: short
duration_s: 30
clock: wall
loop: { rate_hz: 100, heartbeat_ms: 1000 }
channels:
  table:
    kind: registers
    backend: modbus
    rate_hz: 20
    latency_ms: 50
    address: 127.0.0.1
    port: 15100
    registers: [{ name: position, table: input_registers, address: 0, type: s32, scale: 0.001, unit: deg }]
sinks:
  drive:
    backend: modbus
    latency_ms: 10
    address: 127.0.0.1
    port: 15100
    registers:
      - { name: enable, table: holding_registers, address: 0, type: u16 }
      - { name: target_rate, table: holding_registers, address: 4, type: s32, scale: 0.001, unit: deg/s }
    safe: { enable: 0, target_rate: 0 }
    watchdog: { register: { name: timeout, table: holding_registers, address: 6, type: u16 }, timeout_ms: 1500 }
application: { name: script, sinks: { drive: { rate_hz: 0.2, steps: [{ at_s: 0, values: [1, 30] }] } } }
emulators:
)";
  for (int i = 0; i < kTables; ++i)
    text += "  t" + std::to_string(i) + ": { backend: modbus, port: " + std::to_string(port_of(i)) +
            ", model: turntable }\n";
  return text;
}

class Signals : public ::testing::Test {
 protected:
  void SetUp() override {
    write_file(dir / "rig.yaml", rig_text());
    tables = std::make_unique<Command>(rigor_words({"emulate", (dir / "rig.yaml").string()}));
    for (int t = 0; t < 20000 && tables->out().find("until Ctrl-C") == std::string::npos; t += 20)
      sleep_ms(20);
    ASSERT_THAT(tables->out(), HasSubstr("until Ctrl-C")) << tables->err();
  }
  [[nodiscard]] std::filesystem::path recording(int table) const {
    return dir / ("run" + std::to_string(table) + ".mcap");
  }
  [[nodiscard]] std::vector<std::string> words(int table) const {
    const std::string port = ".port=" + std::to_string(port_of(table));
    return rigor_words({"run", (dir / "rig.yaml").string(), "--no-emulators", "--no-control", "--json",
                        "--set", "channels.table" + port, "--set", "sinks.drive" + port, "--record",
                        recording(table).string()});
  }
  std::unique_ptr<Command> start(int table) const {
    std::error_code ec;
    std::filesystem::remove(recording(table), ec);
    return std::make_unique<Command>(words(table));
  }
  /// Until the run has the table in motion.
  static void wait_until_it_turns(int table) {
    for (int t = 0; t < 20000 && enable_of(table) != 1; t += 20) sleep_ms(20);
    ASSERT_EQ(enable_of(table), 1) << "nothing would be tried";
  }
  void expect_whole(int table, const std::string& what) const {
    if (!std::filesystem::exists(recording(table))) return;  // the run had not come so far
    const auto reader = record::McapReader::open(recording(table).string());
    ASSERT_TRUE(reader) << what << ": " << reader.error().text();
    EXPECT_TRUE((*reader)->health().good() && (*reader)->health().indexed) << what;
  }
  void expect_nothing_left() const {
    for (const auto& entry : std::filesystem::directory_iterator(dir.path()))
      EXPECT_THAT(entry.path().filename().string(), ::testing::Not(HasSubstr(".part")));
  }

  TempDir dir;
  std::unique_ptr<Command> tables;
};

bool goes_on(int signal) {
  static const std::set<int> kGoesOn{SIGCHLD, SIGCONT, SIGURG,  SIGWINCH, SIGPIPE,
                                     SIGXFSZ, SIGTSTP, SIGTTIN, SIGTTOU,  SIGSTOP};
  return kGoesOn.contains(signal);
}

TEST_F(Signals, EachLeavesTheTableSafeAndTheRecordingWhole) {
  std::vector<int> signals;
  for (int s = 1; s <= 31; ++s) signals.push_back(s);
  for (const int s : {SIGRTMIN, SIGRTMIN + 5, SIGRTMAX}) signals.push_back(s);
  ASSERT_LE(signals.size(), std::size_t{kTables});
  const char* given = std::getenv("RIGOR_SIGNAL_INSTANTS");
  const int instants = given ? std::atoi(given) : 3;
  // Up to the first cycle, which comes a second after the channels are armed, at it, and later.
  for (int instant = 0; instant < instants; ++instant) {
    const int at_ms = instants > 3 ? 30 + 3000 * instant / (instants - 1) : 200;
    const bool in_motion = instants <= 3 && instant > 0;
    std::vector<std::unique_ptr<Command>> runs;
    for (int i = 0; i < static_cast<int>(signals.size()); ++i) runs.push_back(start(i));
    if (!in_motion) sleep_ms(at_ms);
    for (int i = 0; i < static_cast<int>(signals.size()); ++i) {
      if (in_motion) wait_until_it_turns(i);
      if (in_motion && instant == 2 && i == 0) sleep_ms(1800);  // longer than the watchdog
      if (in_motion) {
        EXPECT_EQ(status_of(i) & kEnabledBit, kEnabledBit) << "the sink keeps its watchdog quiet";
      }
      runs[static_cast<std::size_t>(i)]->signal(signals[static_cast<std::size_t>(i)]);
    }
    sleep_ms(2000);  // the watchdog's time for those that were killed or stopped
    for (int i = 0; i < static_cast<int>(signals.size()); ++i) {
      const int s = signals[static_cast<std::size_t>(i)];
      const std::string what = std::string(strsignal(s)) + " at instant " + std::to_string(instant);
      Command& run = *runs[static_cast<std::size_t>(i)];
      if (s == SIGSTOP && in_motion) {
        EXPECT_EQ(status_of(i) & kEnabledBit, 0) << what;
      }
      if (goes_on(s)) {
        run.signal(SIGCONT);
        if (in_motion) {  // before that it may not have come to ignoring it
          EXPECT_TRUE(run.running()) << what << ": " << run.err();
        }
        run.signal(SIGTERM);
      }
    }
    for (int i = 0; i < static_cast<int>(signals.size()); ++i) {
      const int s = signals[static_cast<std::size_t>(i)];
      const std::string what = std::string(strsignal(s)) + " at instant " + std::to_string(instant);
      const Said said = runs[static_cast<std::size_t>(i)]->wait(std::chrono::seconds(20));
      EXPECT_EQ(status_of(i) & kEnabledBit, 0) << what << ": " << said.err;
      if (in_motion && s != SIGKILL) {
        EXPECT_EQ(said.status, 0) << what << ": " << said.err;
        EXPECT_EQ(enable_of(i), 0) << what;
        EXPECT_TRUE(std::filesystem::exists(recording(i))) << what;
      }
      if (s != SIGKILL) expect_whole(i, what);
    }
  }
  for (int i = 0; i < kTables; ++i) EXPECT_EQ(status_of(i) & kMovingBit, 0) << "table " << i;
  if (instants <= 3) expect_nothing_left();
}

// What a dropped ssh does: the terminal is gone, SIGHUP comes more than once, and stderr takes nothing any
// more.
TEST_F(Signals, ATerminalThatGoesAwayEndsTheRunInOrder) {
  auto run = words(0);
  std::vector<char*> argv;
  for (auto& w : run) argv.push_back(w.data());
  argv.push_back(nullptr);
  int terminal = -1;
  const pid_t pid = forkpty(&terminal, nullptr, nullptr, nullptr);
  if (pid == 0) {
    for (int s = 1; s < NSIG; ++s) ::signal(s, SIG_DFL);
    execv(argv[0], argv.data());
    _exit(127);
  }
  wait_until_it_turns(0);
  close(terminal);
  for (int i = 0; i < 5; ++i) kill(pid, SIGHUP), sleep_ms(10);
  int status = 0;
  waitpid(pid, &status, 0);
  EXPECT_TRUE(WIFEXITED(status)) << "ended by signal " << WTERMSIG(status);
  EXPECT_EQ(enable_of(0), 0);
  ASSERT_TRUE(std::filesystem::exists(recording(0)));
  expect_whole(0, "hangup");
}

TEST_F(Signals, UnderNohupAHangupChangesNothing) {
  auto with = words(1);
  with.insert(with.begin(), "nohup");
  Command run(with);
  wait_until_it_turns(1);
  run.signal(SIGHUP);
  sleep_ms(700);
  EXPECT_TRUE(run.running());
  EXPECT_EQ(status_of(1) & kEnabledBit, kEnabledBit);
  run.signal(SIGINT);
  EXPECT_EQ(run.wait(std::chrono::seconds(20)).status, 0);
  EXPECT_EQ(enable_of(1), 0);
}

// Two quick Ctrl-C: the second does not end what makes the devices safe.
TEST_F(Signals, AQuickSecondInterruptIsNotTheEnd) {
  const auto run = start(2);
  wait_until_it_turns(2);
  run->signal(SIGINT);
  run->signal(SIGINT);
  sleep_ms(1);
  run->signal(SIGINT);
  EXPECT_EQ(run->wait(std::chrono::seconds(20)).status, 0);
  EXPECT_EQ(enable_of(2), 0);
  expect_whole(2, "interrupts");
}

}  // namespace
}  // namespace rigor::test
