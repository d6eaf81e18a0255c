// `rigor sweep`: many runs of one rig, with all that may happen to them meanwhile.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <unistd.h>

#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/cli/sweep_fixture.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TEST_F(Sweep, MakesATableAReportAndCommandsThatRepeatARun) {
  const Said said = sweep({"--vary", "channels.wave.signals.x.sine.amplitude=1..5:3", "--vary",
                           "channels.wave.faults.0.probability=0.1,0.4", "--seeds", "3", "--json"});
  EXPECT_EQ(said.status, 1) << "an amplitude of 5 is not as expected: " << said.err;
  const json result = json::parse(said.out);
  EXPECT_EQ(result["runs"], 18);
  EXPECT_EQ(result["passed"].get<int>() + result["failed"].get<int>(), 18);
  EXPECT_GE(result["failed"], 6);
  const auto rows = table();
  ASSERT_EQ(rows.size(), 18U);
  for (const auto& row : rows) {
    const bool too_large = row.at("channels.wave.signals.x.sine.amplitude") == "5";
    EXPECT_EQ(row.at("expect wave.x value of at most 3"), too_large ? "violated" : "holds");
    if (too_large) {
      EXPECT_THAT(row.at("reason"), HasSubstr("wave.x: expected value of at most 3"));
    }
    EXPECT_EQ(row.at("input_sha256").size(), 64U);
  }
  EXPECT_NE(rows[0].at("wave delivered") + rows[0].at("input_sha256"),
            rows[1].at("wave delivered") + rows[1].at("input_sha256"))
      << "seeds differ";

  // The worst run by the page: its command makes it again.
  const std::string page = read_file(out / "index.html");
  EXPECT_THAT(page, AllOf(HasSubstr("not as expected: wave.x value of at most 3"), HasSubstr("<svg"),
                          HasSubstr("explains"), HasSubstr("Wilson")));
  const std::string tag = "id=\"run-12\"><td>run 12, failed</td><td><code>";
  const auto at = page.find(tag);
  ASSERT_NE(at, std::string::npos) << "the first run with an amplitude of 5";
  std::string command = page.substr(at + tag.size(), page.find("</code>", at) - at - tag.size());
  ASSERT_THAT(command, HasSubstr("rigor run "));
  EXPECT_THAT(command, HasSubstr("seed=1"));
  command.replace(0, 5, rigor_words({}).front());
  const Said again = Command({"sh", "-c", command + " --json"}, dir.path()).wait();
  EXPECT_EQ(again.status, 1);
  EXPECT_EQ(json::parse(again.out)["input_sha256"], rows[12].at("input_sha256"));
}

TEST_F(Sweep, GivesTheSameBytesWithAnyNumberOfJobsAndRunByRun) {
  ASSERT_EQ(sweep(more_runs({"--jobs", "1"})).status, 0);
  const std::string one = read_file(out / "table.csv"), page = read_file(out / "index.html");
  EXPECT_EQ(table().size(), kRuns);
  fs::remove_all(out);
  ASSERT_EQ(sweep(more_runs({"--jobs", "3"})).status, 0);
  EXPECT_EQ(read_file(out / "table.csv"), one);
  EXPECT_EQ(read_file(out / "index.html"), page);
  fs::remove_all(out);

  // As GNU parallel would, and then several by one process, as in an array that is limited.
  ASSERT_EQ(sweep(more_runs({"--plan"})).status, 0);
  const std::string unit = rigor_words({}).front() + " sweep -o out --index";
  const Said some = Command({"sh", "-c", "seq 11 -1 6 | xargs -P 2 -I{} " + unit + " {}"}, dir.path()).wait();
  EXPECT_EQ(some.status, 0) << some.err;
  const Said partly = go_on({"--report"});
  EXPECT_EQ(partly.status, 1);
  EXPECT_THAT(partly.out, HasSubstr("6 of 12 runs passed, 6 not run"));
  EXPECT_EQ(table()[0].at("status"), "not run");
  for (const char* index : {"0", "1"}) EXPECT_EQ(go_on({"--index", index, "--every", "4"}).status, 0);
  const Said rest =
      Command({"sh", "-c", "for i in 2 3; do JOB_COMPLETION_INDEX=$i " + unit + " auto --every 4; done"},
              dir.path())
          .wait();
  EXPECT_EQ(rest.status, 0) << rest.err;
  EXPECT_EQ(go_on({"--report"}).status, 0);
  EXPECT_EQ(read_file(out / "table.csv"), one);
}

TEST_F(Sweep, GoesOnAfterKillsAtTwentyInstants) {
  ASSERT_EQ(sweep(more_runs({}, "6")).status, 0);
  const std::string whole = read_file(out / "table.csv");
  fs::remove_all(out);
  const auto rows_there = [&] {
    std::size_t n = 0;
    std::error_code ec;
    for (const auto& entry : fs::directory_iterator(out / "runs", ec))
      n += entry.path().extension() == ".json";
    return n;
  };
  std::size_t before_last = 0;
  for (int kill = 0; kill < 20; ++kill) {
    const std::size_t before = rows_there();
    Command command(rigor_words(sweep_words(more_runs({"--jobs", "2"}, "6"))), dir.path());
    // Some after a row, the others at any instant: while it starts, while runs work, while rows are written.
    if (kill % 3 == 1)
      while (command.running() && rows_there() == before) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::microseconds(2000 + kill * 7919));
    command.signal(SIGKILL);
    (void)command.wait();
    std::error_code ec;
    if (fs::exists(out / "sweep.json", ec)) {
      EXPECT_FALSE(json::parse(read_file(out / "sweep.json")).empty());
    }
    for (const auto& entry : fs::directory_iterator(out / "runs", ec)) {
      ASSERT_EQ(entry.path().extension(), ".json") << "nothing but whole rows lies there";
      EXPECT_TRUE(json::parse(read_file(entry.path())).contains("status"));
    }
    EXPECT_GE(rows_there(), before) << "a kill loses no row";
    before_last = rows_there();
  }
  EXPECT_GT(before_last, 0U) << "the kills came before any run had ended";
  const Said last = sweep(more_runs({"--jobs", "2"}, "6"));
  EXPECT_EQ(last.status, 0) << last.err;
  EXPECT_EQ(read_file(out / "table.csv"), whole);
  EXPECT_TRUE(fs::is_empty(out / "work"));
}

TEST_F(Sweep, EndsOnCtrlCAndGoesOnLater) {
  Command command(rigor_words(sweep_words(more_runs({"--jobs", "1"}))), dir.path());
  std::error_code ec;
  while (command.running() && !fs::exists(out / "runs" / "000001.json", ec)) std::this_thread::yield();
  command.signal(SIGINT);
  const Said said = command.wait();
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.err, AllOf(HasSubstr("interrupted"), HasSubstr("the same command goes on")));
  EXPECT_TRUE(fs::is_empty(out / "work"));
  EXPECT_FALSE(fs::exists(out / "table.csv"));
  EXPECT_EQ(go_on({}).status, 0) << "without the rig, too";
  EXPECT_EQ(table().size(), kRuns);
}

TEST_F(Sweep, MakesARowOfACrashAndOfAnError) {
  write_file(dir / "crash.sh", "test -e calm && exit 3\nkill -KILL $PPID\nsleep 100\n");
  const std::string here = dir.path().string();
  const std::vector<std::string> words{
      "--vary", "application.command=[sh, -c, \"cd " + here + "; . ./crash.sh\"],[sh, -c, exit 4]", "--seeds",
      "2"};
  const Said said = sweep(words);
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.out, HasSubstr("0 of 4 runs passed, 2 broke off or could not run, 2 crashed")) << said.err;
  auto rows = table();
  ASSERT_EQ(rows.size(), 4U);
  EXPECT_EQ(rows[0].at("status"), "crashed");
  EXPECT_EQ(rows[0].at("reason"), "signal 9, Killed");
  EXPECT_EQ(rows[2].at("status"), "error");
  EXPECT_THAT(rows[2].at("reason"), HasSubstr("exit status 4"));
  EXPECT_THAT(read_file(out / "index.html"), HasSubstr("crashed: signal 9, Killed"));
  const std::string before = read_file(out / "table.csv");
  EXPECT_EQ(go_on({}).status, 1);
  EXPECT_EQ(read_file(out / "table.csv"), before) << "they are not made again by themselves";
  write_file(dir / "calm", "");
  EXPECT_EQ(go_on({"--retry"}).status, 1);
  rows = table();
  EXPECT_EQ(rows[0].at("status"), "error");
  EXPECT_THAT(rows[0].at("reason"), HasSubstr("exit status 3"));
}

TEST_F(Sweep, EndsARunThatHangs) {
  const Said said = sweep({"--set", "application.command=[sh, -c, sleep 1000]", "--timeout", "1"});
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.out, HasSubstr("0 of 1 run passed, 1 took too long")) << said.err;
  EXPECT_EQ(table()[0].at("status"), "timeout");
}

TEST_F(Sweep, RefusesWhatIsWrongBeforeAnythingRuns) {
  const auto refused = [&](const std::vector<std::string>& more, const auto& matcher) {
    const Said said = sweep(more);
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_THAT(said.err, matcher);
    EXPECT_FALSE(fs::exists(out));
  };
  refused({"--vary", "channels.wavee.rate_hz=10,20"}, HasSubstr("did you mean channels.wave?"));
  refused({"--vary", "channels.wave.lost_after_mz=10,20"}, HasSubstr("did you mean lost_after_ms?"));
  refused({"--vary", "channels.wave.rate_hz=10,-5,20"},
          AllOf(HasSubstr("--vary channels.wave.rate_hz=-5"), HasSubstr("got -5")));
  // What the backend alone knows, in the middle of the list.
  refused(
      {"--vary", "channels.wave.signals.x={constant: 1},{sine: {amplitud: 2, period_s: 1}},{constant: 2}"},
      HasSubstr("amplitude"));
  refused({"--vary", "loop.rate_hz=50,100", "--vary", "loop.rate_hz=200"},
          HasSubstr("expected each key once, got loop.rate_hz again"));
  refused({"--vary", "loop.rate_hz=50,50"}, HasSubstr("expected each value once, got 50 again"));
  refused({"--vary", "loop.rate_hz=50..100"}, AllOf(HasSubstr("50..100:10"), HasSubstr("--sample N")));
  refused({"--vary", "loop.rate_hz"}, HasSubstr("expected KEY=VALUES"));
  refused({"--vary", "seed=1,2"}, HasSubstr("--seeds"));
  refused({"--seeds", "0"}, HasSubstr("--seeds: expected a whole number from 1"));
  refused({"--sample", "0"}, HasSubstr("--sample: expected a whole number from 1"));
  refused({"--sample", "5"}, HasSubstr("--vary with what is to be drawn"));
  refused({"--seed", "5"}, HasSubstr("expected it with --sample"));
  refused({"--jobs", "0"}, HasSubstr("--jobs"));
  refused({"--every", "3"}, HasSubstr("expected it with --index"));
  refused({"--index", "3", "--report"}, HasSubstr("expected one of them"));
  refused({"--vary", "loop.rate_hz=50..100:100000", "--seeds", "100"}, HasSubstr("at most 1000000 runs"));
  refused({"--set", "duration_s=0"}, HasSubstr("--duration"));
  const Said none = go_on({});
  EXPECT_EQ(none.status, 2);
  EXPECT_THAT(none.err, HasSubstr("found no sweep.json"));
  const Said without_rig = go_on({"--seeds", "3"});
  EXPECT_EQ(without_rig.status, 2);
  EXPECT_THAT(without_rig.err, HasSubstr("RIG"));
  fs::create_directory(out);
  write_file(out / "thesis.txt", "mine");
  EXPECT_THAT(sweep({}).err, HasSubstr("got one with thesis.txt in it"));
}

TEST_F(Sweep, RefusesAFolderOfAnotherSweepWithTheDifference) {
  ASSERT_EQ(sweep({"--seeds", "2"}).status, 0);
  const Said other = sweep({"--seeds", "3"});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err, AllOf(HasSubstr("sweep.json"), HasSubstr("is 2 there, and 3 here")));
  EXPECT_THAT(go_on({"--index", "2"}).err, HasSubstr("expected one of the runs 0 to 1, got 2"));
  EXPECT_EQ(sweep({"--seeds", "2"}).status, 0);
  write_file(dir / "rig.yaml", read_file(dir / "rig.yaml") + "# changed\n");
  EXPECT_THAT(sweep({"--seeds", "2"}).err, HasSubstr("inputs.rig.yaml is"));
  EXPECT_THAT(go_on({"--index", "1"}).err, HasSubstr("as it was when the sweep began"));
}

TEST_F(Sweep, IsAloneInItsFolderAndSingleRunsAreNot) {
  ASSERT_EQ(sweep({"--seeds", "2", "--plan"}).status, 0);
  const int lock = ::open((out / ".lock").c_str(), O_RDWR);
  ASSERT_GE(lock, 0);
  ASSERT_EQ(::flock(lock, LOCK_EX), 0);
  for (const auto& words : {std::vector<std::string>{}, {"--index", "1"}}) {
    const Said said = go_on(words);
    EXPECT_EQ(said.status, 2);
    EXPECT_THAT(said.err, HasSubstr("another process makes runs of this sweep"));
  }
  ASSERT_EQ(::flock(lock, LOCK_SH), 0) << "another single run";
  EXPECT_EQ(go_on({}).status, 2);
  EXPECT_EQ(go_on({"--index", "1"}).status, 0);
  ::close(lock);
  EXPECT_EQ(go_on({}).status, 0);
}

TEST_F(Sweep, SaysThatTheDiskIsFullAndGoesOnWhenThereIsRoom) {
  ASSERT_EQ(sweep(more_runs({})).status, 0);
  const std::string whole = read_file(out / "table.csv");
  fs::remove_all(out);
  fs::create_directory(out);
  if (::mount("tmpfs", out.c_str(), "tmpfs", 0, "size=32k") != 0)
    GTEST_SKIP() << "a small disk cannot be mounted here (needs root)";
  const Said full = sweep(more_runs({}));
  EXPECT_EQ(full.status, 1);
  EXPECT_THAT(full.err, AllOf(HasSubstr("no space"), HasSubstr("the same command goes on from there")))
      << full.err;
  EXPECT_FALSE(fs::exists(out / "table.csv"));
  ASSERT_EQ(::mount("tmpfs", out.c_str(), "tmpfs", MS_REMOUNT, "size=8m"), 0);
  const Said again = sweep(more_runs({}));
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(read_file(out / "table.csv"), whole);
  ::umount(out.c_str());
}

TEST_F(Sweep, MakesNoRowOfARunWhoseRecordingFindsTheDiskFull) {
  const std::vector<std::string> words{"--set", "record={file: run.mcap}",
                                       "--set", "sinks={estimate: {backend: log, signals: [x, y, yaw]}}",
                                       "--set", "analyses={localization: {truth: wave, estimate: estimate}}"};
  fs::create_directory(out);
  if (::mount("tmpfs", out.c_str(), "tmpfs", 0, "size=16k") != 0)
    GTEST_SKIP() << "a small disk cannot be mounted here (needs root)";
  const Said full = sweep(words);
  EXPECT_EQ(full.status, 1);
  EXPECT_THAT(full.err,
              AllOf(HasSubstr("no space"), HasSubstr("recording.mcap"), HasSubstr("0 of 1 runs are there")));
  EXPECT_TRUE(fs::is_empty(out / "runs"));
  ASSERT_EQ(::mount("tmpfs", out.c_str(), "tmpfs", MS_REMOUNT, "size=8m"), 0);
  const Said again = sweep(words);
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_TRUE(fs::is_empty(out / "work")) << "the recording was for the analysis alone";
  ::umount(out.c_str());
}

TEST_F(Sweep, LeavesCellsEmptyThatARunDoesNotReport) {
  EXPECT_EQ(sweep({"--vary", "channels.wave.faults.0.probability=0,1"}).status, 1);
  const auto rows = table();
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_NE(rows[0].at("wave age_p50_ms"), "");
  EXPECT_EQ(rows[1].at("wave age_p50_ms"), "") << "nothing came";
  EXPECT_EQ(rows[1].at("wave delivered"), "0");
  EXPECT_THAT(read_file(out / "index.html"), HasSubstr("1 of 2 runs passed"));
}

TEST_F(Sweep, OfOneRunIsThatRun) {
  const Said said = sweep({});
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, HasSubstr("1 of 1 run passed"));
  EXPECT_EQ(table().size(), 1U);
}

TEST_F(Sweep, SaysHowFarItHasComeAndHowLongItTakes) {
  const Said said = sweep(more_runs({"--progress", "json"}));
  ASSERT_EQ(said.status, 0) << said.err;
  json last;
  for (std::size_t at = 0; at < said.err.size();) {
    const std::size_t end = said.err.find('\n', at);
    if (const json line = json::parse(said.err.substr(at, end - at), nullptr, false);
        line.is_object() && line["task"] == "sweep")
      last = line;
    at = end + 1;
  }
  EXPECT_EQ(last["done"], kRuns);
  EXPECT_EQ(last["total"], kRuns);
  EXPECT_EQ(last["eta_s"], 0);
}

TEST_F(Sweep, VariesTheWeatherByItsPresets) {
  write_file(dir / "rig.yaml", R"(
duration_s: 0.2
clock: virtual
loop: { rate_hz: 100 }
simulation: { world: )" + config("worlds/testbed.yaml") +
                                   R"( }
channels:
  odometry:
    kind: odometry
    backend: simulated
    rate_hz: 50
    sensor: )" + config("sensors/odometry-skid-steer.yaml") +
                                   R"(
    T_world_sensor: { position_m: [2, 0, 0], roll_pitch_yaw_deg: [0, 0, 90] }
    motion: { velocity_m_per_s: [0, 0.8, 0] }
)");
  EXPECT_EQ(sweep({"--vary", "simulation.weather=clear,fog,rain"}).status, 0);
  EXPECT_EQ(table()[1].at("simulation.weather"), "fog");
  fs::remove_all(out);
  EXPECT_THAT(sweep({"--vary", "simulation.weather=clear,foggy"}).err,
              AllOf(HasSubstr("--vary simulation.weather=foggy"), HasSubstr("did you mean 'fog'?")));
}

}  // namespace
}  // namespace rigor::test
