// Whole runs of the demo rig, from the command line to the files they leave.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/sha.h>
#include <signal.h>
#include <sys/mount.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "cli/device_signals.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

std::string sha256(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  std::array<unsigned char, SHA256_DIGEST_LENGTH> digest{};
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), digest.data());
  return {digest.begin(), digest.end()};
}
json channel(const json& result, const std::string& name) {
  for (const json& c : result["channels"])
    if (c["name"] == name) return c;
  return {};
}
void sleep_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }
/// Until a line with `text` was printed.
bool wait_for(const Command& command, const std::string& text, int patience_ms = 20000) {
  for (int t = 0; t < patience_ms && command.running(); t += 20) {
    if ((command.out() + command.err()).find(text) != std::string::npos) return true;
    sleep_ms(20);
  }
  return false;
}

class Runs : public ::testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  /// The demo with its outputs in the test's own folder, as JSON.
  std::vector<std::string> demo(std::vector<std::string> more) const {
    std::vector<std::string> words{"run",      config("demo.yaml"), "--json", "--record", file("run.mcap"),
                                   "--report", file("report")};
    words.insert(words.end(), more.begin(), more.end());
    return rigor_words(std::move(words));
  }
  /// In virtual time, with cameras that are faster than a small machine could keep.
  std::vector<std::string> fast_demo(std::vector<std::string> more) const {
    for (const char* word : {"channels.left.rate_hz=25", "channels.left.latency_ms=100",
                             "channels.right.rate_hz=25", "channels.right.latency_ms=60"})
      more.insert(more.begin(), {"--set", word});
    more.insert(more.begin(), {"--clock", "virtual"});
    return demo(std::move(more));
  }
  TempDir dir;
};

TEST_F(Runs, InVirtualTimeRepeatByteForByteOnAnyNumberOfWorkers) {
  std::string first_file, first_seen;
  for (const char* workers : {"1", "2", "1", "2", "1"}) {
    const Said said = Command(fast_demo({"--duration", "0.8", "--workers", workers})).wait();
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    const std::string seen = result["seen_sha256"];
    ASSERT_FALSE(seen.empty());
    // One world, one model, two noises: no bias, and the sigma of two cameras' noise and a few edges.
    const json pair = channel(result, "left")["pair"];
    EXPECT_GE(pair["count"], 17);
    EXPECT_NEAR(pair["bias"].get<double>(), 0, 0.1);
    EXPECT_GT(pair["sigma"].get<double>(), 0.5);
    EXPECT_LT(pair["sigma"].get<double>(), 6);
    if (first_seen.empty()) first_seen = seen;
    EXPECT_EQ(seen, first_seen) << workers << " workers";
    if (first_file.empty()) first_file = sha256(dir / "run.mcap");
    EXPECT_EQ(sha256(dir / "run.mcap"), first_file);
  }
}

TEST_F(Runs, InVirtualTimeDifferWithTheSeed) {
  std::string seen[2];
  for (int i = 0; i < 2; ++i) {
    const Said said =
        Command(fast_demo({"--duration", "0.3", "--set", "seed=" + std::to_string(i + 1)})).wait();
    ASSERT_EQ(said.status, 0) << said.err;
    seen[i] = json::parse(said.out)["seen_sha256"];
  }
  EXPECT_NE(seen[0], seen[1]);
}

TEST_F(Runs, OnTheWallClockAreReplayedExactlyAndTwoReplaysAreEqualFiles) {
  const Said run = Command(demo({"--duration", "3"})).wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json result = json::parse(run.out), seen = result["seen_sha256"];
  ASSERT_NE(seen, "");
  if (result["recording"]["dropped"] > 0)
    GTEST_SKIP() << "this machine could not record all of it, and says so: " << result["recording"];
  for (const char* name : {"one.mcap", "two.mcap"}) {
    const Said replay = rigor({"replay", file("run.mcap"), "--record", file(name), "--json"});
    ASSERT_EQ(replay.status, 0) << replay.err;
    EXPECT_EQ(json::parse(replay.out)["seen_sha256"], seen);
  }
  EXPECT_EQ(sha256(dir / "one.mcap"), sha256(dir / "two.mcap"));
  // What it tells on the way: nothing is lost before it begins.
  const Said told = rigor({"replay", file("run.mcap")});
  ASSERT_EQ(told.status, 0) << told.err;
  EXPECT_EQ((told.out + told.err).find("LOST"), std::string::npos) << told.out << told.err;
  // And a replay of a replay is still the same.
  const Said again = rigor({"replay", file("one.mcap"), "--json"});
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["seen_sha256"], seen);
}

TEST_F(Runs, TakeOneChannelFromARecordingByOneLineOfTheRig) {
  ASSERT_EQ(Command(fast_demo({"--duration", "1"})).wait().status, 0);
  write_file(dir / "rig.yaml",
             "channels:\n"
             "  right: { kind: image, backend: replay, file: run.mcap, rate_hz: 25, latency_ms: 60 }\n"
             "  table: { kind: registers, backend: replay, file: run.mcap, channel: turntable, rate_hz: 100, "
             "latency_ms: 10 }\n");
  for (const char* clock : {"virtual", "wall"}) {
    const Said said = rigor({"run", "rig.yaml", "--clock", clock, "--duration", "0.9", "--json"}, dir.path());
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    EXPECT_NEAR(
        channel(result, "right")["fresh"].get<int>() + channel(result, "right")["superseded"].get<int>(), 21,
        3)
        << clock;
    EXPECT_NEAR(
        channel(result, "table")["fresh"].get<int>() + channel(result, "table")["superseded"].get<int>(), 88,
        6)
        << clock;
  }
}

/// A recorded value by time since its first sample.
std::shared_ptr<SignalModel> recorded_value(const std::filesystem::path& file, const std::string& more = "") {
  const auto n = ConfigDocument::parse("{signals: {position: {recording: " + file.string() +
                                           ", channel: table, value: position" + more + "}}}",
                                       "test.yaml");
  EXPECT_TRUE(n);
  return read_device_signals(*n, {}, {}, {});
}

// An emulated node whose signal was recorded of another one sends what was recorded.
TEST_F(Runs, OfADeviceWhoseSignalsComeFromARecordingSeeWhatWasRecorded) {
  const Said first = rigor({"run", config("rigs/can.yaml"), "--clock", "virtual", "--duration", "2", "--json",
                            "--record", file("first.mcap"), "--report", file("report")});
  ASSERT_EQ(first.status, 0) << first.err;
  const std::string dbc = config("buses/turntable.dbc");
  write_file(dir / "rig.yaml",
             "duration_s: 1.9\nclock: virtual\nloop: { rate_hz: 1000 }\n"
             "channels:\n  table: { kind: registers, backend: can, emulated_by: node, rate_hz: 100, "
             "latency_ms: 5, interface: vcan0, dbc: " +
                 dbc +
                 ", signals: [{ message: TableState, signal: position }] }\n"
                 "emulators:\n  node: { backend: can, interface: vcan0, dbc: " +
                 dbc +
                 ", node: Turntable, signals: { position: { recording: first.mcap, channel: table, value: "
                 "position, repeat: true }, rate: { constant: 0 } } }\n"
                 "record: { file: second.mcap }\n");
  const Said second = rigor({"run", "rig.yaml", "--json"}, dir.path());
  ASSERT_EQ(second.status, 0) << second.err;
  const auto was = recorded_value(dir / "first.mcap"), is = recorded_value(dir / "second.mcap");
  double least = 1e9, most = -1e9;
  for (int ms = 20; ms < 1850; ms += 10) {
    const BenchTime t = BenchTime(0) + milliseconds(ms);
    if (ms == 20) (void)was->read(0, BenchTime(0)), (void)is->read(0, BenchTime(0));
    const double a = was->read(0, t), b = is->read(0, t);
    // Both are sampled on grids of 10 ms and sent every 5 ms, at up to 31 deg/s.
    EXPECT_NEAR(a, b, 31 * 0.025) << ms;
    least = std::min(least, b), most = std::max(most, b);
  }
  EXPECT_GT(most - least, 10) << "degrees; else nothing was tried";
  // Past its end a recording says nothing, or begins again.
  const auto again = recorded_value(dir / "first.mcap", ", repeat: true");
  (void)again->read(0, BenchTime(0));
  EXPECT_TRUE(std::isnan(was->read(0, BenchTime(0) + seconds(3))));
  EXPECT_TRUE(std::isfinite(again->read(0, BenchTime(0) + seconds(3))));
}

TEST_F(Runs, OfTheDemoAccountForEveryInstantAndReport) {
  const Said run = Command(demo({"--duration", "4"})).wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json result = json::parse(run.out);
  const json left = channel(result, "left"), right = channel(result, "right"),
             table = channel(result, "turntable");
  // Every instant is accounted for: seen, overtaken by a newer one, or counted as lost. How many are lost is
  // a matter of the machine and of its other work, and no matter of a test; benches measure it.
  for (const auto& [c, rate_hz] : {std::pair{left, 5.0}, {right, 5.0}, {table, 100.0}}) {
    const double seen =
        c["fresh"].get<double>() + c["superseded"].get<double>() + c["lost_samples"].get<double>();
    EXPECT_NEAR(seen, 4 * rate_hz, 0.06 * 4 * rate_hz + 3) << c["name"];
    EXPECT_GT(c["fresh"], 5) << c["name"];
    EXPECT_NEAR(c["delivered"].get<double>() + c["missing"].get<double>(), c["due"].get<double>(), 2);
  }
  EXPECT_EQ(result["sinks"][0]["applied"].get<int>() + result["sinks"][0]["failed"].get<int>() +
                result["sinks"][0]["dropped"].get<int>(),
            200);
  const std::string page = read_file(dir / "report/index.html");
  for (const char* part : {"Wake-up error", "Misses and their causes", "left: real against simulated",
                           "left-first.png", "right-last.png", "</html>"})
    EXPECT_THAT(page, HasSubstr(part));
  EXPECT_GT(std::filesystem::file_size(dir / "report/right-last.png"), 1000u);
}

TEST_F(Runs, SwitchAPairWithoutAGapAndRecordTheSwitch) {
  const Said run =
      Command(
          fast_demo(
              {"--duration", "2", "--set",
               "channels.left.pair.switches=[{at_s: 0.8, hand_on: simulated}, {at_s: 1.4, hand_on: real}]"}))
          .wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json left = channel(json::parse(run.out), "left");
  EXPECT_EQ(left["pair"]["switches"], 2);
  EXPECT_EQ(left["gap_count"], 0);
  EXPECT_EQ(left["lost_samples"], 0);
  EXPECT_EQ(left["late_cycles"], 0);
  const Said inspect = rigor({"inspect", file("run.mcap"), "--json"});
  EXPECT_EQ(inspect.status, 0);
  EXPECT_THAT(inspect.out, HasSubstr("/rigor/events"));
}

TEST_F(Runs, GoOnWhenTheCameraIsKilledAndSeeItReturn) {
  Command table(rigor_words({"emulate", config("demo.yaml"), "--only", "turntable"}));
  auto camera = std::make_unique<Command>(rigor_words({"emulate", config("demo.yaml"), "--only", "left"}));
  ASSERT_TRUE(wait_for(table, "until Ctrl-C"));
  ASSERT_TRUE(wait_for(*camera, "until Ctrl-C"));
  // It ends long after the camera's return, so that a busy machine has time to find it again.
  Command run(demo({"--no-emulators", "--duration", "15"}));
  sleep_ms(4500);
  camera->signal(SIGKILL);
  camera.reset();
  sleep_ms(1500);
  camera = std::make_unique<Command>(rigor_words({"emulate", config("demo.yaml"), "--only", "left"}));
  const Said said = run.wait();
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out), left = channel(result, "left");
  EXPECT_GT(left["lost_cycles"], 300) << "the channel says lost while the camera is away";
  EXPECT_GE(left["health"]["reconnects"], 1);
  EXPECT_GT(left["lost_samples"], 4) << "what was missed is counted";
  // A late sample may stand between any two; that the camera is seen again after it was lost is what counts.
  bool was_lost = false, returned = false;
  for (const json& span : left["status"]) {
    was_lost = was_lost || span["status"] == "lost";
    returned = returned || (was_lost && span["status"] == "fresh");
  }
  EXPECT_TRUE(returned) << left["status"];
  EXPECT_EQ(result["loop"]["cycles_run"].get<int>() + result["loop"]["cycles_skipped"].get<int>(), 15000);
  EXPECT_GT(result["loop"]["cycles_run"], 7500) << "the loop goes on";
}

/// The process that a run has brought its emulators up in; 0: none yet.
pid_t emulators_of(pid_t run) {
  std::ifstream children("/proc/" + std::to_string(run) + "/task/" + std::to_string(run) + "/children");
  pid_t pid = 0;
  children >> pid;
  return pid;
}

TEST_F(Runs, WhoseEmulatorsDieSayItAtOnceAndFail) {
  Command run(demo({"--duration", "10"}));
  // The recording grows once the loop runs.
  for (int i = 0; i < 600 && (!std::filesystem::exists(dir / "run.mcap") ||
                              std::filesystem::file_size(dir / "run.mcap") < 200'000);
       ++i)
    sleep_ms(50);
  const pid_t emulators = emulators_of(run.pid());
  ASSERT_GT(emulators, 0) << run.err();
  kill(emulators, SIGKILL);
  EXPECT_TRUE(wait_for(run, "died: signal 9", 3000)) << run.err();
  EXPECT_TRUE(run.running()) << "it is said while the run goes on";
  const Said said = run.wait();
  EXPECT_EQ(said.status, 1) << said.err;
  const json result = json::parse(said.out), table = channel(result, "turntable");
  EXPECT_EQ(result["verdict"]["state"], "bad");
  EXPECT_EQ(result["verdict"]["findings"][0]["kinds"], json::array({"emulator"}));
  EXPECT_GT(table["due"], 990);
  EXPECT_LT(table["delivered"], 900) << "of a device that is gone it is known what was due";
  EXPECT_LT(table["rate_hz"].get<double>(), 91) << "over the whole run, and not until it died";
  EXPECT_LT(table["silent_since_s"].get<double>(), 9);
  EXPECT_THAT(read_file(dir / "report/index.html"), HasSubstr("Verdict: bad"));
}

TEST_F(Runs, FailOnWhatTheyAreToldToFailOn) {
  const std::vector<std::string> drop{
      "--clock", "virtual", "--duration",
      "0.5",     "--set",   "channels.turntable.faults=[{kind: drop, probability: 0.5}]"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.begin(), drop.begin(), drop.end());
    return Command(demo(std::move(more))).wait();
  };
  const Said plain = with({});
  ASSERT_EQ(plain.status, 0) << plain.err;
  EXPECT_THAT(json::parse(plain.out)["warnings"].dump(), HasSubstr("injected faults took"));
  EXPECT_EQ(with({"--fail-on", "late,alarm"}).status, 0);
  const Said failed = with({"--fail-on", "late,lost"});
  EXPECT_EQ(failed.status, 1);
  EXPECT_EQ(json::parse(failed.out)["verdict"]["failed_on"], json::array({"lost"}));
  EXPECT_THAT(failed.err, HasSubstr("--fail-on lost: turntable: "));
  const Said unknown = with({"--fail-on", "lats"});
  EXPECT_EQ(unknown.status, 2);
  EXPECT_THAT(unknown.err, HasSubstr("did you mean late?"));
}

TEST_F(Runs, LeaveTheTurntableSafeOnCtrlC) {
  Command run(demo({"--duration", "60"}));
  sleep_ms(6000);
  ASSERT_TRUE(run.running()) << run.err();
  run.signal(SIGINT);
  const Said said = run.wait(std::chrono::seconds(20));
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  EXPECT_THAT(result["loop"]["reason"].get<std::string>(), HasSubstr("signal"));
  EXPECT_GE(result["sinks"][0]["made_safe"], 1);
  EXPECT_TRUE(std::filesystem::exists(dir / "report/index.html"));
}

TEST_F(Runs, KilledWhileRecordingLoseAtMostASecond) {
  Command run(demo({"--duration", "60"}));
  for (int i = 0; i < 400 && (!std::filesystem::exists(dir / "run.mcap") ||
                              std::filesystem::file_size(dir / "run.mcap") < 4'000'000);
       ++i)
    sleep_ms(50);
  sleep_ms(2000);
  const auto killed = std::chrono::system_clock::now();
  run.signal(SIGKILL);
  EXPECT_EQ(run.wait().status, 128 + SIGKILL);

  const Said repair = rigor({"inspect", file("run.mcap"), "--repair", "-o", file("whole.mcap"), "--json"});
  ASSERT_EQ(repair.status, 0) << repair.err;
  EXPECT_GT(json::parse(repair.out)["messages"], 200);
  const Said inspect = rigor({"inspect", file("whole.mcap"), "--json"});
  ASSERT_EQ(inspect.status, 0) << inspect.err;
  const json report = json::parse(inspect.out);
  const auto text = [](const json& v) {
    return v.is_string() ? std::stoll(v.get<std::string>()) : v.get<long long>();
  };
  const double last_s = static_cast<double>(text(report["last_ns"])) * 1e-9;
  const double killed_s = std::chrono::duration<double>(killed.time_since_epoch()).count();
  EXPECT_GT(last_s, killed_s - 1.0);
  EXPECT_EQ(rigor({"replay", file("whole.mcap"), "--json"}).status, 0) << "what is left can be replayed";
}

TEST_F(Runs, EndWhenTheDiskIsFullAndWhatIsWrittenStaysReadable) {
  const std::filesystem::path disk = dir / "disk";
  std::filesystem::create_directory(disk);
  if (mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=12m") != 0)
    GTEST_SKIP() << "a small disk cannot be mounted here (needs root)";
  const Said said = rigor({"run", config("demo.yaml"), "--json", "--clock", "virtual", "--duration", "20",
                           "--record", (disk / "run.mcap").string(), "--report", file("report")});
  EXPECT_EQ(said.status, 1) << said.err;
  EXPECT_THAT(said.err, HasSubstr("space"));
  EXPECT_THAT(said.err, HasSubstr("run.mcap"));
  EXPECT_LT(json::parse(said.out)["loop"]["cycles_run"], 20000) << "said at once, not at the end";
  const Said inspect = rigor({"inspect", (disk / "run.mcap").string(), "--json"});
  EXPECT_EQ(inspect.status, 0) << inspect.err;
  ASSERT_EQ(inspect.status, 0);
  EXPECT_GT(json::parse(inspect.out)["messages"], 10);
  umount(disk.c_str());
}

TEST_F(Runs, WriteATraceThatIsJson) {
  const Said said =
      Command(demo({"--clock", "virtual", "--duration", "0.1", "--trace", file("trace.json")})).wait();
  ASSERT_EQ(said.status, 0) << said.err;
  const json trace = json::parse(read_file(dir / "trace.json"));
  EXPECT_GT((trace.is_array() ? trace : trace["traceEvents"]).size(), 100u);
}

// Each kind of driver and sink: what the application saw of a device is seen again from the recording.
TEST_F(Runs, EveryRigInTheTreeLoadsAndRunsAndIsReplayed) {
  int rigs = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(RIGOR_SOURCE_DIR "/configs")) {
    const std::string text = entry.is_regular_file() ? read_file(entry.path()) : "";
    if (entry.path().extension() != ".yaml" || text.find("\nchannels:") == std::string::npos) continue;
    ++rigs;
    const Said said = rigor({"run", entry.path().string(), "--clock", "virtual", "--duration", "0.2",
                             "--json", "--record", file("any.mcap"), "--report", file("any")});
    ASSERT_EQ(said.status, 0) << entry.path() << ": " << said.err;
    const Said replay = rigor({"replay", file("any.mcap"), "--json"});
    ASSERT_EQ(replay.status, 0) << entry.path() << ": " << replay.err;
    EXPECT_EQ(json::parse(replay.out)["seen_sha256"], json::parse(said.out)["seen_sha256"]) << entry.path();
  }
  EXPECT_GE(rigs, 8);
}

TEST_F(Runs, SenseGivesTheSampleOfARun) {
  const Said said = rigor({"sense", config("demo.yaml"), "--channel", "left", "--joint", "turntable=20", "-o",
                           file("left.png"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["width_px"], 480);
  EXPECT_GT(std::filesystem::file_size(dir / "left.png"), 10'000u);
  EXPECT_EQ(rigor({"sense", config("demo.yaml"), "--channel", "right", "-o", file("right.exr")}).status, 0);
  EXPECT_GT(std::filesystem::file_size(dir / "right.exr"), 10'000u);
}

TEST_F(Runs, DevicesAndDoctorSpeakJson) {
  Command camera(rigor_words({"emulate", config("demo.yaml"), "--only", "left"}));
  ASSERT_TRUE(wait_for(camera, "until Ctrl-C"));
  const Said devices = rigor({"devices", "--json"});
  EXPECT_EQ(devices.status, 0);
  EXPECT_THAT(json::parse(devices.out)["devices"].dump(), HasSubstr("Rigor"));
  const Said doctor = rigor({"doctor", "--json"});
  EXPECT_EQ(doctor.status, 0);
  EXPECT_GT(json::parse(doctor.out)["findings"].size(), 4u);
  camera.signal(SIGINT);
  EXPECT_EQ(camera.wait(std::chrono::seconds(10)).status, 0);
}

}  // namespace
}  // namespace rigor::test
