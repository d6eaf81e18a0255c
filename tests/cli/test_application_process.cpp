// The software under test as a program of its own: what it sees, what it commands, and what becomes of the
// run when it is slow, silent or gone.
#include <gmock/gmock.h>
#include <signal.h>

#include <cstdlib>
#include <thread>

#include "tests/cli/recorded_messages.h"
#include "tests/cli/runs_fixture.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

const std::string kDetectorPy = rigor::test::source_dir() + "/examples/application/detector.py";

class ApplicationProcess : public Runs {
 protected:
  /// A rig of an inertial sensor at 100 Hz and a sink that moves nothing, for the program `app.py`.
  [[nodiscard]] std::string rig(const std::string& keys = "") const {
    return "duration_s: 1\nclock: virtual\nloop: { rate_hz: 1000 }\nsimulation: { world: " +
           config("worlds/testbed.yaml") +
           " }\nrecord: { file: run.mcap }\nchannels:\n  imu: { kind: imu, backend: simulated, rate_hz: 100, "
           "latency_ms: 4, sensor: " +
           config("sensors/imu-mems.yaml") +
           ", T_world_sensor: { position_m: [2, 0, 0.5], quaternion_wxyz: [1, 0, 0, 0] } }\n"
           "sinks:\n  out: { backend: log, signals: [force, samples] }\n"
           "application: { command: [python3, app.py], rate_hz: 50" +
           keys + " }\n";
  }
  /// `step` of an application that counts the samples of `imu` and tells the newest one.
  [[nodiscard]] static std::string program(const std::string& before = "", const std::string& more = "") {
    return "import os, sys, time, rigor_client\n"
           "class App(rigor_client.Application):\n"
           "    n = 0\n"
           "    turns = 0\n"
           "    def step(self, turn):\n"
           "        self.turns += 1\n" +
           before +
           "        imu = turn['imu']\n"
           "        self.n += len(imu.samples)\n"
           "        if imu.fresh:\n"
           "            turn.command('out', force=imu.sample.specific_force_mps2[2], samples=self.n)\n" +
           more + "rigor_client.run(App())\n";
  }
  Said run(const std::string& rig_text, const std::string& app, std::vector<std::string> more = {}) const {
    write_file(dir / "rig.yaml", rig_text);
    write_file(dir / "app.py", app);
    more.insert(more.begin(), {"run", "rig.yaml", "--json", "--force"});
    return rigor(std::move(more), dir.path());
  }
  /// Every turn that was due was given or left out, but for those whose cycle the loop itself skipped.
  static void expect_turns(const json& result, int due) {
    const int turns = result["application"]["turns"].get<int>() + result["application"]["skipped"].get<int>();
    EXPECT_LE(turns, due);
    EXPECT_GE(turns + result["loop"]["cycles_skipped"].get<int>(), due);
  }
};

TEST_F(ApplicationProcess, InPythonInCppAndAsASharedObjectDoTheSameInVirtualTime) {
  std::vector<std::string> recorded[4];
  std::string seen[4];
  const std::string python = std::string("command: [python3, ") + kDetectorPy + "]";
  const std::string programs[] = {python, "command: [" RIGOR_DETECTOR "]", "library: " RIGOR_DETECTOR_PLUGIN,
                                  python};
  for (int i = 0; i < 4; ++i) {
    const Said said =
        Command(fast_demo({"--duration", "0.6", "--force", "--set", "application={" + programs[i] + "}"}))
            .wait();
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    EXPECT_EQ(result["application"]["turns"], 30);
    EXPECT_EQ(result["application"]["answered"], 30);
    EXPECT_EQ(result["sinks"][0]["accepted"], 30);
    EXPECT_GT(channel(result, "right")["fresh"], 10);
    seen[i] = result["input_sha256"];
    recorded[i] = all_messages(dir / "run.mcap");
    ASSERT_GT(recorded[i].size(), 200U);
  }
  for (int i = 1; i < 4; ++i) {
    EXPECT_EQ(seen[i], seen[0]) << programs[i];
    EXPECT_TRUE(recorded[i] == recorded[0]) << programs[i];
  }
}

TEST_F(ApplicationProcess, SeesEverySampleAndItsSpeedChangesNothingInVirtualTime) {
  const Said quick = run(rig(), program());
  ASSERT_EQ(quick.status, 0) << quick.err;
  const auto recorded = all_messages(dir / "run.mcap");
  const json result = json::parse(quick.out);
  EXPECT_EQ(result["application"]["samples"]["delivered"], 98) << "the last turn is at 0.98 s";
  EXPECT_EQ(result["application"]["samples"]["after_last"], 2);
  EXPECT_EQ(result["application"]["samples"]["dropped"], 0);
  EXPECT_EQ(result["sinks"][0]["accepted"], 49) << "the first turn has no sample yet";
  const Said slow = run(rig(), program("        time.sleep(0.02 if self.turns % 7 == 0 else 0)\n"));
  ASSERT_EQ(slow.status, 0) << slow.err;
  EXPECT_EQ(json::parse(slow.out)["input_sha256"], result["input_sha256"]);
  EXPECT_TRUE(all_messages(dir / "run.mcap") == recorded);
  // A replay starts the program again, and it sees the same.
  const Said again = rigor({"replay", "run.mcap", "--json", "--run-program"}, dir.path());
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["input_sha256"], result["input_sha256"]);
}

TEST_F(ApplicationProcess, OfARecordingIsNotRunUnasked) {
  write_file(dir / "app.py", program());
  ASSERT_EQ(run(rig(), program()).status, 0);
  write_file(dir / "app.py", "open('it-ran', 'w')\n");
  const Said said = rigor({"replay", "run.mcap"}, dir.path());
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, AllOf(HasSubstr("python3 app.py"), HasSubstr("--run-program")));
  EXPECT_FALSE(std::filesystem::exists(dir / "it-ran"));
  // What one names oneself needs no leave.
  const std::string own = "application={command: [python3, " + file("own.py") + "], rate_hz: 50}";
  write_file(dir / "own.py", program());
  EXPECT_EQ(rigor({"replay", "run.mcap", "--set", own}, dir.path()).status, 0);
}

TEST_F(ApplicationProcess, KnowsItsRigParametersAndPorts) {
  const Said said = run(
      rig(", params: { limit: 3, name: hi, deep: [1, 2.5, {on: true}] }"),
      "import rigor_client\n"
      "class App(rigor_client.Application):\n"
      "    def start(self, rig):\n"
      "        assert rig.params == {'limit': 3, 'name': 'hi', 'deep': [1, 2.5, {'on': True}]}, rig.params\n"
      "        assert rig.clock == 'virtual' and rig.loop_rate_hz == 1000 and rig.duration_s == 1\n"
      "        imu = rig.inputs['imu']\n"
      "        assert (imu.kind, imu.rate_hz, imu.latency_ms) == ('imu', 100, 4), vars(imu)\n"
      "        assert rig.outputs['out']['names'] == ['force', 'samples']\n"
      "    def step(self, turn):\n"
      "        assert turn.t_ns == turn.cycle * 1000000\n"
      "        if turn['imu'].fresh:\n"
      "            s = turn['imu'].sample\n"
      "            assert s.t_capture_ns + 4000000 == s.t_release_ns <= turn.t_ns\n"
      "            assert 9 < s.specific_force_mps2[2] < 11, s.specific_force_mps2\n"
      "rigor_client.run(App())\n");
  EXPECT_EQ(said.status, 0) << said.err;
}

TEST_F(ApplicationProcess, ThatRaisesEndsTheRunWithItsReason) {
  const Said said = run(rig(), program("        if self.turns == 9: raise ValueError('no way out')\n"));
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.err, AllOf(HasSubstr("rig.yaml:10:"), HasSubstr("says: ValueError: no way out")));
  EXPECT_THAT(said.out, HasSubstr("aborted: the application cannot go on"));
  EXPECT_FALSE(all_messages(dir / "run.mcap").empty()) << "what was recorded until then is whole";
}

TEST_F(ApplicationProcess, ThatEndsEndsTheRunOrIsStartedAgainAsTheRigSays) {
  const std::string once =
      "        if self.turns == 9 and not os.path.exists('died'):\n"
      "            open('died', 'w').close()\n"
      "            os._exit(3)\n";
  const Said ended = run(rig(), program(once));
  EXPECT_EQ(ended.status, 1);
  EXPECT_THAT(ended.err, HasSubstr("ended: exit status 3"));
  std::filesystem::remove(dir / "died");
  const Said again = run(rig(", on_exit: restart"), program(once));
  EXPECT_EQ(again.status, 0) << again.err;
  EXPECT_THAT(again.err, AllOf(HasSubstr("ended: exit status 3"), HasSubstr("started again")));
  const json result = json::parse(again.out);
  EXPECT_EQ(result["application"]["restarts"], 1);
  EXPECT_EQ(result["application"]["answered"], 50);
  EXPECT_THAT(result["verdict"].dump(), HasSubstr("it was started again 1 times"));
}

TEST_F(ApplicationProcess, AsASharedObjectThatThrowsEndsTheRunWithItsReason) {
  write_file(dir / "rig.yaml",
             rig().replace(rig().find("command: [python3, app.py]"), 26, "library: " RIGOR_DETECTOR_PLUGIN));
  const Said said = rigor({"run", "rig.yaml", "--json"}, dir.path());
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.err, HasSubstr("says: the rig has no input right"));
  EXPECT_THAT(said.out, HasSubstr("aborted: the application cannot go on"));
}

TEST_F(ApplicationProcess, ThatHangsIsKilled) {
  const Said said =
      run(rig(", answer_timeout_s: 0.3"), program("        if self.turns == 9: time.sleep(60)\n"));
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.err, HasSubstr("gave no answer within 0.3 s"));
}

TEST_F(ApplicationProcess, IsToldWhatWasExpectedWhereTheRigIsWrong) {
  const auto refused = [&](const std::string& text, const std::string& app, auto what) {
    const Said said = run(text, app);
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_THAT(said.err, what);
    EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
  };
  const auto with = [&](const std::string& application) {
    const std::string text = rig();
    return text.substr(0, text.find("application:")) + "application: " + application + "\n";
  };
  refused(with("{ command: [no-such-program] }"), "",
          AllOf(HasSubstr("rig.yaml:10:"), HasSubstr("\"no-such-program\": No such file")));
  refused(with("{ command: [] }"), "", HasSubstr("expected a program and its arguments"));
  refused(with("{ command: [python3], name: script }"), "", HasSubstr("got both name and command"));
  refused(with("{ rate_hz: 5 }"), "", HasSubstr("`command`"));
  refused(with("{ library: ./none.so }"), "", AllOf(HasSubstr("rig.yaml:10:"), HasSubstr("found no file")));
  refused(with("{ library: app.py }"), "", HasSubstr("can be loaded"));
  refused(with("{ library: /lib/x86_64-linux-gnu/libz.so.1 }"), "", HasSubstr("symbol rigor_application"));
  refused(with("{ library: " RIGOR_DETECTOR_PLUGIN ", rate: 5 }"), "", HasSubstr("rate_hz"));
  refused(with("{ command: [python3, app.py], rate_hz: 5000 }"), "", HasSubstr("from 0.001 to 1000"));
  refused(with("{ command: [python3, app.py], on_exit: rest }"), "", HasSubstr("restart"));
  refused(with("{ command: [python3, app.py], rate: 5 }"), "", HasSubstr("rate_hz"));
}

TEST_F(ApplicationProcess, ThatDoesNotSpeakTheProtocolIsNamed) {
  const auto fails = [&](const std::string& app, auto what) {
    const Said said = run(rig(", start_timeout_s: 2, answer_timeout_s: 2"), app);
    EXPECT_EQ(said.status, 1) << said.err;
    EXPECT_THAT(said.err, what);
  };
  const std::string connect =
      "import socket, struct, os, json, time\n"
      "s = socket.socket(socket.AF_UNIX); s.connect(os.environ['RIGOR_SOCKET'])\n"
      "def send(kind, body): s.sendall(struct.pack('<II', len(body), kind) + body)\n"
      "def receive():\n"
      "    size, kind = struct.unpack('<II', s.recv(8, socket.MSG_WAITALL)); return kind, s.recv(size, "
      "socket.MSG_WAITALL)\n";
  const std::string meet = connect +
                           "send(1, b'{\"protocol\": 1}'); receive(); send(3, b'{}')\n"
                           "kind, turn = receive(); cycle, = struct.unpack_from('<Q', turn)\n";
  fails("import sys; sys.exit(7)\n", HasSubstr("ended before it connected to RIGOR_SOCKET: exit status 7"));
  fails("import time; time.sleep(60)\n", HasSubstr("did not connect to RIGOR_SOCKET within 2 s"));
  fails(connect + "send(1, b'{\"protocol\": 99}'); time.sleep(60)\n", HasSubstr("expected protocol 1"));
  fails(connect + "send(1, b'nonsense'); time.sleep(60)\n", HasSubstr("expected JSON, got \"nonsense\""));
  // The deepest text that a message may hold: it fails the start, and not the bench.
  fails(connect + "send(1, b'{\"protocol\": ' + b'[' * 400000 + b']' * 400000 + b'}'); time.sleep(60)\n",
        HasSubstr("nested at most 64 levels"));
  fails(connect + "s.sendall(struct.pack('<II', 1 << 31, 1)); time.sleep(60)\n",
        HasSubstr("message of at most"));
  fails(connect +
            "send(1, b'{\"protocol\": 1}'); receive(); send(8, b'{\"error\": \"not my rig\"}'); "
            "time.sleep(60)\n",
        HasSubstr("says: not my rig"));
  const auto malformed = HasSubstr("gave an answer that the protocol does not know");
  fails(meet + "send(5, struct.pack('<QII', cycle + 1, 0, 0)); time.sleep(60)\n", malformed);
  fails(meet + "send(5, struct.pack('<QIIII', cycle, 1, 0, 7, 2)); time.sleep(60)\n", malformed);
  fails(meet + "send(5, struct.pack('<QIIIId', cycle, 1, 0, 0, 1, 1.0)); time.sleep(60)\n", malformed);
  fails(meet + "send(5, struct.pack('<QII', cycle, 1 << 30, 0)); time.sleep(60)\n", malformed);
  fails(meet + "send(5, b'short'); time.sleep(60)\n", malformed);
  fails(meet + "s.sendall(struct.pack('<II', 1 << 20, 5)); time.sleep(60)\n", malformed);
  fails(meet + "s.close(); time.sleep(60)\n", HasSubstr("closed its connection"));
}

TEST_F(ApplicationProcess, LeavesWithTheRunThatIsInterrupted) {
  write_file(dir / "rig.yaml", rig(", answer_timeout_s: 60"));
  write_file(dir / "app.py",
             program("        if self.turns == 5:\n            print(os.getpid(), flush=True)\n"
                     "            time.sleep(60)\n"));
  Command command(rigor_words({"run", "rig.yaml", "--force"}), dir.path());
  // Until the program says its process number.
  for (int i = 0; i < 6000 && command.err().find('\n') == std::string::npos; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  const auto pid = static_cast<pid_t>(std::atoi(command.err().c_str()));
  ASSERT_GT(pid, 1) << command.err();
  command.signal(SIGINT);
  const Said said = command.wait();
  EXPECT_THAT(said.out, HasSubstr("interrupted by a signal"));
  EXPECT_NE(kill(pid, 0), 0) << "it lives on";
}

// In wall-clock time.

TEST_F(ApplicationProcess, IsNeverWaitedForInWallClockTime) {
  const Said said = run(rig(), program("        if self.turns % 5 == 0: time.sleep(0.05)\n"),
                        {"--clock", "wall", "--duration", "2"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  const json& a = result["application"];
  EXPECT_GT(a["late"], 8);
  EXPECT_GT(a["skipped"], 8);
  expect_turns(result, 100);
  EXPECT_EQ(a["samples"]["dropped"], 0);
  EXPECT_THAT(result["verdict"].dump(), HasSubstr("answers were late"));
  EXPECT_LT(result["loop"]["cycle_time"]["p99_ns"], 2'000'000);
}

TEST_F(ApplicationProcess, ThatIsLateLeavesTheSinksSafeWhereTheRigSaysSo) {
  const auto run_with = [&](const std::string& on_late) {
    const Said said = Command(demo({"--duration", "3", "--force", "--set",
                                    "application={command: [python3, " + file("app.py") +
                                        "], rate_hz: 50, on_late: " + on_late + "}"}))
                          .wait();
    EXPECT_EQ(said.status, 0) << said.err;
    return json::parse(said.out)["sinks"][0]["made_safe"].get<int>();
  };
  write_file(dir / "app.py",
             "import time, rigor_client\n"
             "class App(rigor_client.Application):\n"
             "    turns = 0\n"
             "    def step(self, turn):\n"
             "        self.turns += 1\n"
             "        if self.turns == 40: time.sleep(0.6)\n"
             "        turn.command('table_command', enable=1, target_rate=1)\n"
             "rigor_client.run(App())\n");
  const int held = run_with("hold"), safe = run_with("safe");
  EXPECT_EQ(safe, held + 1) << "once more than at the end of the run";
}

TEST_F(ApplicationProcess, ThatIsKilledInWallClockTimeComesBack) {
  const std::string app = program("        open('pid', 'w').write(str(os.getpid()))\n");
  write_file(dir / "rig.yaml", rig(", on_exit: restart"));
  write_file(dir / "app.py", app);
  Command command(rigor_words({"run", "rig.yaml", "--json", "--force", "--clock", "wall", "--duration", "6"}),
                  dir.path());
  int killed = 0;
  std::string last;
  // Until three processes were killed, each after some turns: a program writes its number in every turn.
  for (int i = 0; i < 600 && killed < 3; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    std::error_code none;
    const std::string pid = std::filesystem::exists(dir / "pid", none) ? read_file(dir / "pid") : "";
    if (pid.empty() || pid == last) continue;
    last = pid;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));  // five turns
    killed += kill(static_cast<pid_t>(std::stoi(pid)), SIGKILL) == 0;
  }
  const Said said = command.wait();
  EXPECT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  EXPECT_EQ(result["application"]["restarts"], killed);
  EXPECT_EQ(killed, 3);
  EXPECT_THAT(said.err, HasSubstr("signal 9"));
  expect_turns(result, 300);
}

}  // namespace
}  // namespace rigor::test
