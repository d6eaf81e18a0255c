// `rigor check`: a recording is judged as its run was, by its own rig or another, without running anything.
#include <gmock/gmock.h>

#include <algorithm>
#include <set>

#include "tests/cli/expect_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class Check : public Expect {
 protected:
  [[nodiscard]] Said check(std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"check", "run.mcap", "--json"});
    return rigor(std::move(more), dir.path());
  }
  /// Expects that a check of run.mcap says the same as `run` did of all that a recording tells, and returns
  /// what it does not tell.
  static std::set<std::string> expect_same(const json& run, const Said& checked) {
    std::set<std::string> unknown;
    const json all = json::parse(checked.out)["expect"];
    EXPECT_EQ(all.size(), run["expect"].size());
    bool fails = false;
    for (std::size_t i = 0; i < std::min(all.size(), run["expect"].size()); ++i) {
      fails = fails || all[i]["state"] == "violated";
      if (all[i]["state"] == "unknown") {
        EXPECT_TRUE(all[i]["holds"].is_null());
        unknown.insert(all[i]["of"].get<std::string>() + " " + all[i]["quantity"].get<std::string>());
      } else {
        EXPECT_EQ(all[i], run["expect"][i]);
      }
    }
    EXPECT_EQ(checked.status, fails ? 1 : 0) << checked.err;
    return unknown;
  }
};

constexpr const char* kOfEach =
    "  - { of: truth, rate_hz: { min: 101 }, missing: { max: 0 }, late: { max: 0 }, age_ms: { max: 4 }, "
    "age_p99_ms: "
    "{ max: 5.2 } }\n"
    "  - { of: imu, missing: { max: 0 }, rate_hz: { min: 90 } }\n"
    "  - { of: imu, missing: { max: 0 }, from_s: 0.1, until_s: 0.55 }\n"
    "  - { of: imu.force_z_mps2, value: { max: 9 }, from_s: 0.2 }\n"
    "  - { of: truth.x_m, value: { max: -1.19 }, per_s: { max: 0.5 } }\n"
    "  - { of: drive.v, value: { max: 0.5 }, per_s: { max: 20 } }\n"
    "  - { of: estimate, against: truth, position_m: { max: 0.01 }, yaw_deg: { max: 1 } }\n"
    "  - { of: loop, skipped: { max: 0 }, misses: { max: 0 }, wake_p50_us: { max: 1 }, wake_p99_us: { max: 1 "
    "}, "
    "wake_max_us: { max: 1 }, cycle_p99_us: { max: 1e6 } }\n"
    "  - { of: drive, failed: { max: 0 }, late: { max: 0 }, dropped: { max: 0 } }\n";

TEST_F(Check, SaysOfARecordingWhatTheRunSaid) {
  const Said run = this->run(kOfEach, {"--record", "run.mcap"});
  EXPECT_EQ(run.status, 1) << run.err;
  const std::set<std::string> unknown = expect_same(json::parse(run.out), check());
  EXPECT_EQ(unknown,
            (std::set<std::string>{"loop misses", "loop wake_p50_us", "loop wake_p99_us", "loop wake_max_us",
                                   "loop cycle_p99_us", "drive failed", "drive late", "drive dropped"}));

  const Said said = rigor({"check", "run.mcap", "--junit", "junit.xml"}, dir.path());
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(
      said.out,
      AllOf(HasSubstr(" hold, 8 cannot be determined from a recording (expecting, 1.000 s)\n"),
            HasSubstr(
                "\ndoes not hold   drive.v value of at most 0.5: got 0 to 1; 10 of 20, first at 0.500 s\n"),
            HasSubstr("\nholds           truth missing of at most 0: got 0\n"),
            HasSubstr("\nunknown         loop misses of at most 0: not in a recording\n")));
  EXPECT_THAT(
      read_file(dir / "junit.xml"),
      AllOf(HasSubstr("<testsuite name=\"expecting\" tests=\"24\" failures=\"7\" errors=\"0\" skipped=\"8\""),
            HasSubstr("<skipped message=\"loop: expected misses of at most 0, cannot be determined"),
            HasSubstr("<failure message=\"drive.v: expected value of at most 0.5, got 0 to 1;"),
            Not(HasSubstr("name=\"run\""))));
  EXPECT_EQ(check({"--junit", "run.mcap"}).status, 2) << "an input is never written over";
}

TEST_F(Check, OfARunByTheWallClockToo) {
  const Said run =
      this->run(kOfEach, {"--record", "run.mcap", "--clock", "wall", "--set", "loop.rate_hz=200"});
  ASSERT_EQ(run.status, 1) << run.err;
  EXPECT_EQ(expect_same(json::parse(run.out), check()).size(), 8U);
}

TEST_F(Check, CountsWhatANewerSampleOvertook) {
  // Samples that wait behind a delayed one are handed on in one cycle; the newest of them alone is seen.
  const Said run =
      this->run("  - { of: imu, missing: { max: 0 }, rate_hz: { min: 98 }, late: { max: 0 } }\n",
                {"--record", "run.mcap", "--set",
                 "channels.imu.faults=[{kind: delay, delay_ms: 55, from_s: 0.3, until_s: 0.31}]"});
  EXPECT_EQ(run.status, 1) << run.err;
  const json result = json::parse(run.out);
  EXPECT_GE(channel(result, "imu")["superseded"], 4);
  EXPECT_TRUE(expect_same(result, check()).empty());
}

TEST_F(Check, OfAPairThatIsSwitched) {
  const Said run =
      Command(
          fast_demo({"--duration", "1", "--set",
                     "channels.left.pair.switches=[{at_s: 0.4, active: simulated}]", "--set",
                     "expect=[{of: left, missing: {max: 0}, age_ms: {max: 90}, rate_hz: {min: 24}, alarm: "
                     "false}, {of: right, missing: {max: 0}, age_ms: {max: 70}}, {of: turntable.position, "
                     "value: {max: 1}}, {of: table_command.target_rate, value: {max: 10}}]"}))
          .wait();
  EXPECT_EQ(run.status, 1) << run.err;
  EXPECT_TRUE(expect_same(json::parse(run.out), check()).empty());
}

TEST_F(Check, KnowsWhenFaultsCameAndTheCommandsWereSafe) {
  // The sensor is silent from 0.6 s on; the robot stands when the command of 0.65 s takes effect.
  const Said run = this->run(
      "  - { of: drive, safe_after_ms: { max: 60 }, when: { fault: imu } }\n"
      "  - { of: drive, safe_after_ms: { max: 50 }, when: { fault: imu, kind: drop } }\n"
      "  - { of: drive, safe_after_ms: { max: 54 }, when: { channel: imu, is: overdue } }\n"
      "  - { of: drive, safe_after_ms: { max: 50 }, when: { fault: truth } }\n"
      "  - { of: drive, safe_after_ms: { max: 50 }, when: { fault: drive } }\n",
      {"--record", "run.mcap", "--set",
       "application.sinks.drive.steps=[{at_s: 0, values: [0, 0]}, {at_s: 0.5, values: [1, 0]}, {at_s: 0.65, "
       "values: "
       "[0, 0]}]",
       "--set", "sinks.drive.faults=[{kind: bias, value: w, amount: 0.1, from_s: 0.9}]"});
  EXPECT_EQ(run.status, 1) << run.err;
  const json all = json::parse(run.out)["expect"];
  EXPECT_EQ(all[0]["text"], "drive: expected safe_after_ms of at most 60 after a fault of imu, got 60");
  EXPECT_EQ(
      all[1]["text"],
      "drive: expected safe_after_ms of at most 50 after drop of imu, got 60, first at 0.650 s (it began at "
      "0.600 s; safe after 60 ms)");
  EXPECT_TRUE(all[2]["holds"]) << all[2].dump();
  EXPECT_THAT(all[3]["text"].get<std::string>(), HasSubstr("no such fault came: nothing was tested"));
  EXPECT_TRUE(all[4]["holds"]) << all[4].dump();
  EXPECT_TRUE(expect_same(json::parse(run.out), check()).empty());
  const Said again = rigor({"replay", "run.mcap", "--json"}, dir.path());
  EXPECT_EQ(json::parse(again.out)["expect"], all);
}

TEST_F(Check, KnowsWhenASinkWasMadeSafe) {
  write_file(dir / "app.py",
             "import time, rigor_client\n"
             "class App(rigor_client.Application):\n"
             "    def step(self, turn):\n"
             "        if turn['imu'].status == 'overdue': time.sleep(2.5)\n"
             "        turn.command('drive', v=0.25, w=0)\n"
             "rigor_client.run(App())\n");
  const Said run = this->run(
      "  - { of: drive, safe_after_ms: { max: 1000 }, when: { fault: imu } }\n"
      "  - { of: drive, safe_after_ms: { max: 1 }, when: { fault: imu } }\n",
      {"--record", "run.mcap", "--clock", "wall", "--duration", "2", "--set",
       "loop={rate_hz: 200, heartbeat_ms: 100}", "--set", "channels.imu.faults=[{kind: drop, from_s: 0.6}]",
       "--set", "application={command: [python3, app.py], rate_hz: 50, on_late: safe}"});
  EXPECT_EQ(run.status, 1) << run.err;
  const json result = json::parse(run.out);
  EXPECT_TRUE(result["expect"][0]["holds"]) << result["expect"].dump(1);
  EXPECT_GT(result["expect"][0]["maximum"], 100) << "the loop has to fall silent for that";
  EXPECT_TRUE(expect_same(result, check()).empty());
}

TEST_F(Check, ByAnotherRigsExpectations) {
  ASSERT_EQ(run("  - { of: imu, late: { max: 0 } }\n", {"--record", "run.mcap"}).status, 0);
  write_file(dir / "stricter.yaml", "expect:\n  - { of: imu, missing: { max: 0 } }\n");
  const Said stricter = check({"stricter.yaml"});
  EXPECT_EQ(stricter.status, 1);
  const json all = json::parse(stricter.out)["expect"];
  ASSERT_EQ(all.size(), 1U);
  EXPECT_EQ(all[0]["text"], "imu: expected missing of at most 0, got 10");
  // A whole rig as well, and one value of it by --set.
  write_file(dir / "newer.yaml", rig("  - { of: truth, age_ms: { max: 4 } }\n"));
  EXPECT_EQ(check({"newer.yaml"}).status, 1);
  EXPECT_EQ(check({"newer.yaml", "--set", "expect.0.age_ms.max=6"}).status, 0);
  EXPECT_EQ(check({"--set", "expect=[{of: imu, missing: {max: 0}}]"}).status, 1);

  const auto refused = [&](const std::string& expect, auto what) {
    write_file(dir / "other.yaml", expect);
    const Said said = rigor({"check", "run.mcap", "other.yaml"}, dir.path());
    EXPECT_EQ(said.status, 2) << expect << said.out;
    EXPECT_THAT(said.err, what);
  };
  refused("expect:\n  - { of: imu, late: { max: 0 } }\n  - { of: camera, late: { max: 0 } }\n",
          AllOf(HasSubstr("other.yaml:3:"), HasSubstr("truth, imu, drive, estimate"),
                HasSubstr("got \"camera\"")));
  refused("expect:\n  - { of: imu.force_q, value: { max: 0 } }\n", HasSubstr("other.yaml:2:"));
  refused("expect:\n  - { of: imu, alarm: true }\n", HasSubstr("expected a pair"));
  refused("channels: {}\n", HasSubstr("expected a rig that has `expect:`"));
  refused("expext: []\n", HasSubstr("other.yaml:1:"));
  EXPECT_EQ(check({"none.yaml"}).status, 2);
  const Said absent = rigor({"check", "run.mcap", "--set",
                             "channels.camera={kind: imu, backend: simulated, rate_hz: 10, latency_ms: 1}",
                             "--set", "expect=[{of: camera, late: {max: 0}}]"},
                            dir.path());
  EXPECT_EQ(absent.status, 2);
  EXPECT_THAT(absent.err, HasSubstr("expected a channel that was recorded (imu, truth), got \"camera\""));
}

TEST_F(Check, NeedsNeitherApplicationNorProgram) {
  write_file(dir / "app.py",
             "import rigor_client\n"
             "class App(rigor_client.Application):\n"
             "    def step(self, turn):\n"
             "        turn.command('drive', [0.25, 0])\n"
             "rigor_client.run(App())\n");
  const std::string expect =
      "  - { of: drive.v, value: { max: 0.2 } }\n  - { of: application, late: { max: 0 }, skipped: { max: 0 "
      "}, "
      "restarts: { max: 0 }, answer_p99_ms: { max: 5000 } }\n";
  const Said run = this->run(
      expect, {"--record", "run.mcap", "--set", "application={command: [python3, app.py], rate_hz: 50}"});
  ASSERT_EQ(run.status, 1) << run.err;
  std::filesystem::remove(dir / "app.py");
  std::filesystem::remove(dir / "rig.yaml");
  EXPECT_EQ(expect_same(json::parse(run.out), check()),
            (std::set<std::string>{"application late", "application skipped", "application restarts",
                                   "application answer_p99_ms"}));

  // None at all, and nothing that was expected then.
  std::string bare = rig("");
  bare.erase(bare.find("application:"));
  write_file(dir / "bare.yaml", bare);
  ASSERT_EQ(rigor({"run", "bare.yaml", "--record", "run.mcap", "--force"}, dir.path()).status, 0);
  const Said nothing = rigor({"check", "run.mcap"}, dir.path());
  EXPECT_EQ(nothing.status, 1) << "nothing is expected: its data are judged, which lack a part of imu";
  EXPECT_THAT(nothing.out, HasSubstr("\ngap             /imu/imu at "));
  EXPECT_EQ(check({"--set", "expect=[{of: imu, missing: {max: 10}}, {of: drive.v, value: {max: 1}}]"}).status,
            1)
      << "nothing was commanded";
  EXPECT_EQ(check({"--set", "expect=[{of: imu, missing: {max: 10}}, {of: drive, failed: {max: 0}}]"}).status,
            0);
}

TEST_F(Check, OfARecordingThatWasCutShortWhatThereIs) {
  const Said run =
      this->run("  - { of: truth.x_m, value: { max: -1.19 } }\n  - { of: truth, missing: { max: 0 } }\n",
                {"--record", "run.mcap", "--set", "record={file: run.mcap, chunk_kib: 4}"});
  ASSERT_EQ(run.status, 1) << run.err;
  const std::string whole = read_file(dir / "run.mcap");
  write_file(dir / "run.mcap", whole.substr(0, whole.size() * 6 / 10));
  const Said said = check();
  EXPECT_THAT(said.err, HasSubstr("the recording was cut short"));
  const json checked = json::parse(said.out);
  EXPECT_GT(checked["duration_s"], 0.2);
  EXPECT_LT(checked["duration_s"], 0.9);
  EXPECT_TRUE(checked["cut_short"]);
  EXPECT_TRUE(checked["expect"][1]["holds"]) << checked.dump(1);
}

TEST_F(Check, RefusesWhatIsNoRecordingOfARun) {
  EXPECT_EQ(check().status, 2);
  write_file(dir / "run.mcap", "something else");
  EXPECT_EQ(check().status, 2);
}

}  // namespace
}  // namespace rigor::test
