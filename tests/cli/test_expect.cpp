// What a rig expects of its run: every quantity seen to hold and seen not to, and what a user and a CI server
// get.
#include <gmock/gmock.h>

#include "tests/cli/expect_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TEST_F(Expect, EveryQuantityHoldsWhereItIsSoAndDoesNotWhereItIsNot) {
  struct Case {
    const char *of, *quantity, *holds, *fails, *said;
  };
  const Case cases[] = {
      {"truth", "rate_hz", "{ min: 99.9, max: 100.1 }", "{ min: 101 }",
       "expected rate_hz of at least 101, got 100"},
      {"truth", "missing", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"imu", "missing", "{ min: 9, max: 11 }", "{ max: 0 }", "got 10"},
      {"imu", "late", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"truth", "age_ms", "{ min: 4.9, max: 5.1 }", "{ max: 4 }", "got 5; 100 of 100, first at 0.005 s"},
      {"truth", "age_p99_ms", "{ max: 5.2 }", "{ max: 4 }", "got 5"},
      {"imu.force_z_mps2", "value", "{ min: 9, max: 11 }", "{ max: 9 }", "of 90, first at 0.004 s"},
      {"truth.x_m", "value", "{ min: -1.3, max: 0 }", "{ max: -1.19 }", "first at 0.7"},
      {"truth.x_m", "per_s", "{ min: -0.01, max: 2 }", "{ max: 0.01 }", "first at 0."},
      {"drive.v", "value", "{ min: 0, max: 1 }", "{ max: 0.5 }", "got 0 to 1; 10 of 20, first at 0.500 s"},
      {"drive.v", "per_s", "{ max: 20 }", "{ max: 19 }", "got 0 to 20; 1 of 19, first at 0.500 s"},
      {"drive", "failed", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"drive", "late", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"drive", "dropped", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "skipped", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "misses", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "wake_p50_us", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "wake_p99_us", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "wake_max_us", "{ max: 0 }", "{ min: 1 }", "got 0"},
      {"loop", "cycle_p99_us", "{ min: 0.01 }", "{ max: 0 }", "got "},
  };
  std::string hold, fail;
  for (const Case& c : cases) {
    hold += std::string("  - { of: ") + c.of + ", " + c.quantity + ": " + c.holds + " }\n";
    fail += std::string("  - { of: ") + c.of + ", " + c.quantity + ": " + c.fails + " }\n";
  }
  const std::string error = "  - { of: estimate, against: truth, position_m: { max: ",
                    yaw = " }, yaw_deg: { max: ";
  const Said good = run(hold + error + "1" + yaw + "0.5 } }\n" + error + "0.001 }, until_s: 0.5 }\n");
  EXPECT_EQ(good.status, 0) << good.err;
  const json holds = json::parse(good.out)["expect"];
  ASSERT_EQ(holds.size(), std::size(cases) + 3);
  for (const json& e : holds) EXPECT_TRUE(e["holds"]) << e.dump();

  const Said bad = run(fail + error + "0.01" + yaw + "-1 } }\n");
  EXPECT_EQ(bad.status, 1);
  const json fails = json::parse(bad.out)["expect"];
  ASSERT_EQ(fails.size(), std::size(cases) + 2);
  for (std::size_t i = 0; i < std::size(cases); ++i) {
    EXPECT_FALSE(fails[i]["holds"]) << fails[i].dump();
    EXPECT_EQ(fails[i]["of"], cases[i].of);
    EXPECT_EQ(fails[i]["quantity"], cases[i].quantity);
    EXPECT_THAT(fails[i]["text"].get<std::string>(), HasSubstr(cases[i].said))
        << cases[i].of << " " << cases[i].quantity;
    EXPECT_THAT(bad.err, HasSubstr(fails[i]["text"].get<std::string>()));
  }
  EXPECT_EQ(json::parse(bad.out)["verdict"]["state"], "bad");
  for (std::size_t i = std::size(cases); i < fails.size(); ++i)
    EXPECT_FALSE(fails[i]["holds"]) << fails[i].dump();
  EXPECT_GT(fails[std::size(cases)]["first_s"], 0.5) << "the robot sets out then";
}

TEST_F(Expect, AnApplicationInTurnsIsJudgedAndOneThatIsNotGivesNothingToJudge) {
  const Said none = run("  - { of: application, late: { max: 0 } }\n");
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("nothing came that could be judged"));
  write_file(dir / "app.py",
             "import rigor_client, os\n"
             "class App(rigor_client.Application):\n"
             "    turns = 0\n"
             "    def step(self, turn):\n"
             "        self.turns += 1\n"
             "        if self.turns == 3 and not os.path.exists('died'):\n"
             "            open('died', 'w').close()\n"
             "            os._exit(1)\n"
             "rigor_client.run(App())\n");
  const std::vector<std::string> process{
      "--set", "application={command: [python3, app.py], rate_hz: 50, on_exit: restart}"};
  const Said died =
      run("  - { of: application, late: { max: 0 }, skipped: { max: 0 }, restarts: { max: 0 }, "
          "answer_p99_ms: { max: 1000 } }\n",
          process);
  EXPECT_EQ(died.status, 1) << died.err;
  EXPECT_THAT(died.err, AllOf(HasSubstr("application: expected restarts of at most 0, got 1"),
                              Not(HasSubstr("expected late"))));
  const Said good =
      run("  - { of: application, restarts: { max: 0 }, answer_p99_ms: { max: 5000 } }\n", process);
  EXPECT_EQ(good.status, 0) << good.err;
}

TEST_F(Expect, OfAPairAnAlarmThatComesOrDoesNot) {
  const std::vector<std::string> words{"--duration", "0.3", "--set"};
  const auto status = [&](const std::string& alarm) {
    auto more = words;
    more.push_back("expect=[{of: left, alarm: " + alarm + "}]");
    return Command(fast_demo(more)).wait();
  };
  EXPECT_EQ(status("false").status, 0);
  const Said wanted = status("true");
  EXPECT_EQ(wanted.status, 1);
  EXPECT_THAT(wanted.err, HasSubstr("left: expected an alarm to come, it did not"));
}

TEST_F(Expect, AWindowOfTimeIsJudgedAlone) {
  const Said said =
      run("  - { of: imu, missing: { max: 0 }, rate_hz: { min: 99 }, from_s: 0.1, until_s: 0.55 }\n"
          "  - { of: imu, missing: { min: 9, max: 11 }, from_s: 0.5, until_s: 0.8 }\n"
          "  - { of: imu.force_z_mps2, value: { min: 9 }, from_s: 0.2, until_s: 0.4 }\n"
          "  - { of: truth.x_m, value: { max: -1.19 }, until_s: 0.5 }\n"
          "  - { of: imu.force_z_mps2, value: { min: 9 }, from_s: 0.62, until_s: 0.68 }\n");
  const json all = json::parse(said.out)["expect"];
  ASSERT_EQ(all.size(), 6U);
  for (int i : {0, 1, 2, 3, 4})
    EXPECT_TRUE(all[static_cast<std::size_t>(i)]["holds"]) << all[static_cast<std::size_t>(i)].dump();
  EXPECT_EQ(all[3]["looked_at"], 20);
  EXPECT_EQ(all[0]["bounds"], "of at least 99 from 0.1 to 0.55 s");
  EXPECT_EQ(all[4]["bounds"], "of at most -1.19 until 0.5 s");
  EXPECT_FALSE(all[5]["holds"]) << "nothing came";
}

TEST_F(Expect, AnEstimateIsNotJudgedWhileItIsSearching) {
  const std::vector<std::string> searching{"--set", "sinks.estimate.signals=[x, y, yaw, state]", "--set",
                                           "application.sinks.estimate.steps=[{at_s: 0, values: [50, 0, 0, "
                                           "0]}, {at_s: 0.2, values: [-1.2, -2.6, 0, 1]}]"};
  const Said said =
      run("  - { of: estimate, against: truth, position_m: { max: 0.001 }, until_s: 0.5 }\n", searching);
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["expect"][0]["looked_at"], 16) << "at 50 Hz from 0.2 to 0.5 s";
}

TEST_F(Expect, AReplayJudgesTheSame) {
  const std::string text =
      "  - { of: imu, missing: { max: 0 } }\n  - { of: truth.x_m, value: { max: -1.19 } }\n"
      "  - { of: estimate, against: truth, position_m: { max: 0.01 } }\n";
  const Said first = run(text, {"--record", "run.mcap"});
  const Said again = rigor({"replay", "run.mcap", "--json"}, dir.path());
  EXPECT_EQ(again.status, 1);
  EXPECT_EQ(json::parse(again.out)["expect"], json::parse(first.out)["expect"]);
}

TEST_F(Expect, JunitAndReportHaveWhatDidNotHold) {
  const Said said = run("  - { of: drive.v, value: { max: 0.5 } }\n  - { of: loop, skipped: { max: 0 } }\n",
                        {"--junit", "out/junit.xml", "--report", "report"});
  EXPECT_EQ(said.status, 1);
  const std::string junit = read_file(dir / "out/junit.xml");
  EXPECT_THAT(junit,
              AllOf(HasSubstr("<testsuite name=\"expecting\" tests=\"3\" failures=\"1\""),
                    HasSubstr("<testcase classname=\"expecting\" name=\"run\""),
                    HasSubstr("name=\"drive.v value of at most 0.5\""),
                    HasSubstr("<failure message=\"drive.v: expected value of at most 0.5, got 0 to 1;")));
  EXPECT_THAT(read_file(dir / "report/index.html"),
              AllOf(HasSubstr("Expectations"), HasSubstr("drive.v: expected value"),
                    HasSubstr("got 0 to 1; 10 of 20")));
  // An input is never written over.
  EXPECT_EQ(rigor({"run", "rig.yaml", "--junit", "rig.yaml"}, dir.path()).status, 2);
}

TEST_F(Expect, WhatIsWrittenWronglyIsRefusedAtItsPlace) {
  const auto refused = [&](const std::string& entry, auto what) {
    const Said said = run("  - " + entry + "\n");
    EXPECT_EQ(said.status, 2) << entry << said.err;
    EXPECT_THAT(said.err, AllOf(HasSubstr("rig.yaml:"), what));
  };
  refused("{ of: imo, late: { max: 0 } }", HasSubstr("did you mean imu?"));
  refused("{ of: imu }", HasSubstr("rate_hz, missing, late, age_ms, age_p99_ms"));
  refused("{ of: imu, late: { most: 0 } }", HasSubstr("most"));
  refused("{ of: imu, late: {} }", HasSubstr("got neither"));
  refused("{ of: imu, late: { min: 2, max: 1 } }", HasSubstr("min up to max"));
  refused("{ of: imu, lat: { max: 1 } }", HasSubstr("did you mean late?"));
  refused("{ of: imu, late: { max: 1 }, wake_p99_us: { max: 1 } }", HasSubstr("wake_p99_us"));
  refused("{ of: imu.force_q, value: { max: 1 } }", HasSubstr("force_x_mps2"));
  refused("{ of: drive.u, value: { max: 1 } }", HasSubstr("(v, w)"));
  refused("{ of: imu, alarm: false }", HasSubstr("expected a pair"));
  refused("{ of: estimate, against: imu, position_m: { max: 1 } }", HasSubstr("of kind pose"));
  refused("{ of: drive, against: truth, position_m: { max: 1 } }", HasSubstr("\"x\""));
  refused("{ of: imu, late: { max: 0 }, from_s: 3, until_s: 2 }", HasSubstr("after from_s"));
  refused("{ late: { max: 0 } }", HasSubstr("of"));
}

}  // namespace
}  // namespace rigor::test
