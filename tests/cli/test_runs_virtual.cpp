// Whole runs in virtual time, from the command line to the files they leave. They hold no port and judge no
// time, so any number of them may run at once.
#include <gmock/gmock.h>
#include <sys/mount.h>

#include <cmath>

#include "bench/sensing/device_signals.h"
#include "tests/cli/runs_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

TEST_F(Runs, InVirtualTimeRepeatByteForByteOnAnyNumberOfWorkers) {
  std::string first_file, first_seen;
  for (const char* workers : {"1", "2", "1", "2", "1"}) {
    const Said said = Command(fast_demo({"--duration", "0.8", "--workers", workers})).wait();
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    const std::string seen = result["input_sha256"];
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
    seen[i] = json::parse(said.out)["input_sha256"];
  }
  EXPECT_NE(seen[0], seen[1]);
}

TEST_F(Runs, InVirtualTimeTakeOneChannelFromARecordingByOneLineOfTheRig) {
  take_channels_from_a_recording("virtual");
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
  EXPECT_THAT(read_file(file("report/index.html")), ::testing::Not(::testing::HasSubstr("<h2>The loop</h2>")))
      << "in virtual time that is the host's speed and nothing of the run";
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

TEST_F(Runs, SwitchAPairWithoutAGapAndRecordTheSwitch) {
  const Said run =
      Command(
          fast_demo(
              {"--duration", "2", "--set",
               "channels.left.pair.switches=[{at_s: 0.8, active: simulated}, {at_s: 1.4, active: real}]"}))
          .wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json left = channel(json::parse(run.out), "left");
  EXPECT_EQ(left["pair"]["switches"], 2);
  EXPECT_EQ(left["gap_count"], 0);
  EXPECT_EQ(left["lost_samples"], 0);
  EXPECT_EQ(left["overdue_cycles"], 0);
  const Said inspect = rigor({"inspect", file("run.mcap"), "--json"});
  EXPECT_EQ(inspect.status, 0);
  EXPECT_THAT(inspect.out, HasSubstr("/rigor/events"));
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

TEST_F(Runs, SenseGivesTheSampleOfARun) {
  const Said said = rigor({"sense", config("demo.yaml"), "--channel", "left", "--joint", "turntable=20", "-o",
                           file("left.png"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["width_px"], 480);
  EXPECT_GT(std::filesystem::file_size(dir / "left.png"), 10'000u);
  EXPECT_EQ(rigor({"sense", config("demo.yaml"), "--channel", "right", "-o", file("right.exr")}).status, 0);
  EXPECT_GT(std::filesystem::file_size(dir / "right.exr"), 10'000u);
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

}  // namespace
}  // namespace rigor::test
