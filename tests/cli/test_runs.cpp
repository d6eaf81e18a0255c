// Whole runs of the demo rig on the wall clock, from the command line to the files they leave. They hold the
// demo's ports: one at a time.
#include <gmock/gmock.h>
#include <signal.h>

#include <fstream>
#include <functional>
#include <sstream>
#include <thread>

#include "tests/cli/runs_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

void sleep_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }
/// Until a line with `text` was printed.
bool wait_for(const Command& command, const std::string& text, int timeout_ms = 20000) {
  for (int t = 0; t < timeout_ms && command.running(); t += 20) {
    if ((command.out() + command.err()).find(text) != std::string::npos) return true;
    sleep_ms(20);
  }
  return false;
}

/// What a run says with --progress json; its note: "2000 cycles, …  left 50 LOST (-3)  right 50 …".
struct Progress {
  double t_s = 0;
  std::uint64_t left = 0;  ///< samples that the channel `left` received
  bool left_lost = false;
};
Progress progress(const Command& run) {
  const std::string text = run.err();
  Progress p;
  std::istringstream in(text.substr(0, text.rfind('\n') + 1));
  json last;
  for (std::string line; std::getline(in, line);)
    if (json object = json::parse(line, nullptr, false); object.is_object() && object["task"] == "run")
      last = std::move(object);
  if (!last.is_object()) return p;
  p.t_s = last["done"];
  const std::string note = last["note"];
  const std::size_t from = note.find("  left ");
  if (from == std::string::npos) return p;
  char* after = nullptr;
  p.left = std::strtoull(note.c_str() + from + 7, &after, 10);
  p.left_lost = std::string_view(after).starts_with(" LOST");
  return p;
}
bool wait_until(const Command& run, const std::function<bool(const Progress&)>& so, int timeout_ms = 30000) {
  for (int t = 0; t < timeout_ms && run.running(); t += 20, sleep_ms(20))
    if (so(progress(run))) return true;
  return false;
}

TEST_F(Runs, OnTheWallClockAreReplayedExactlyAndTwoReplaysAreEqualFiles) {
  // Slots for all pictures of the run: the recorder then has a place for each of them, however long a busy
  // machine lets its thread wait.
  Command going(
      demo({"--duration", "3", "--progress", "json", "--set", "channels.left.pair.real.buffers=128", "--set",
            "channels.left.pair.simulated.slots=128", "--set", "channels.right.slots=128"}));
  // Cycles are skipped, as on a machine that is busy otherwise.
  ASSERT_TRUE(wait_until(going, [](const Progress& p) { return p.t_s > 0.5; })) << going.err();
  going.signal(SIGSTOP);
  sleep_ms(40);
  going.signal(SIGCONT);
  const Said run = going.wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json result = json::parse(run.out), seen = result["input_sha256"];
  ASSERT_NE(seen, "");
  ASSERT_GT(result["loop"]["cycles_skipped"], 0);
  ASSERT_EQ(result["recording"]["dropped"], 0) << result["recording"];
  for (const char* name : {"one.mcap", "two.mcap"}) {
    const Said replay = rigor({"replay", file("run.mcap"), "--record", file(name), "--json"});
    ASSERT_EQ(replay.status, 0) << replay.err;
    EXPECT_EQ(json::parse(replay.out)["input_sha256"], seen);
  }
  EXPECT_EQ(sha256(dir / "one.mcap"), sha256(dir / "two.mcap"));
  // What it tells on the way: nothing is lost before it begins.
  const Said told = rigor({"replay", file("run.mcap"), "--progress", "json"});
  ASSERT_EQ(told.status, 0) << told.err;
  EXPECT_THAT(told.err, HasSubstr("\"task\":\"replay\""));
  EXPECT_EQ((told.out + told.err).find("LOST"), std::string::npos) << told.out << told.err;
  // And a replay of a replay is still the same.
  const Said again = rigor({"replay", file("one.mcap"), "--json"});
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["input_sha256"], seen);
}

TEST_F(Runs, OnTheWallClockTakeOneChannelFromARecordingByOneLineOfTheRig) {
  take_channels_from_a_recording("wall");
}

TEST_F(Runs, OfTheDemoAccountForEveryInstantAndReport) {
  const Said run = Command(demo({"--duration", "4"})).wait();
  ASSERT_EQ(run.status, 0) << run.err;
  const json result = json::parse(run.out);
  const json left = channel(result, "left"), right = channel(result, "right"),
             table = channel(result, "turntable");
  // Every instant is accounted for: seen, overtaken by a newer one, or counted as lost. How many are lost is
  // a matter of the machine and of its other work, and no matter of a test; benches measure it.
  for (const auto& [c, rate_hz] : {std::pair{left, 25.0}, {right, 25.0}, {table, 100.0}}) {
    const double seen =
        c["fresh"].get<double>() + c["superseded"].get<double>() + c["lost_samples"].get<double>();
    EXPECT_NEAR(seen, 4 * rate_hz, 0.06 * 4 * rate_hz + 3) << c["name"];
    EXPECT_GT(c["fresh"], 5) << c["name"];
    EXPECT_NEAR(c["delivered"].get<double>() + c["missing"].get<double>(), c["due"].get<double>(), 2);
  }
  // A cycle that was skipped gives no command.
  const int accepted = result["sinks"][0]["accepted"];
  EXPECT_EQ(result["sinks"][0]["applied"].get<int>() + result["sinks"][0]["failed"].get<int>() +
                result["sinks"][0]["dropped"].get<int>(),
            accepted);
  EXPECT_LE(accepted, 200);
  EXPECT_GT(accepted, 150);
  const std::string page = read_file(dir / "report/index.html");
  for (const char* part : {"Wake-up error", "Misses and their causes", "left: real against simulated",
                           "left-first.png", "right-last.png", "</html>"})
    EXPECT_THAT(page, HasSubstr(part));
  // The verdict first, then channels, then what the host did.
  std::size_t before = 0;
  for (const char* part : {"Verdict: ", "<h2>Channels</h2>", "<h2>The loop</h2>", "<h2>About this run</h2>",
                           "<td>Command</td><td><code>rigor run "}) {
    const std::size_t at = page.find(part);
    ASSERT_NE(at, std::string::npos) << part;
    EXPECT_GT(at, before) << part;
    before = at;
  }
  // One file, and nothing is fetched.
  EXPECT_THAT(page, HasSubstr("<img src=\"data:image/png;base64,"));
  EXPECT_THAT(page, ::testing::Not(::testing::ContainsRegex("(src|href)=\"http")));
  EXPECT_THAT(page, HasSubstr("prefers-color-scheme:dark"));
  EXPECT_FALSE(result["machine"].get<std::string>().empty());
  EXPECT_GT(std::filesystem::file_size(dir / "report/right-last.png"), 1000u);
}

TEST_F(Runs, GoOnWhenTheCameraIsKilledAndSeeItReturn) {
  Command table(rigor_words({"emulate", config("demo.yaml"), "--only", "turntable"}));
  auto camera = std::make_unique<Command>(rigor_words({"emulate", config("demo.yaml"), "--only", "left"}));
  ASSERT_TRUE(wait_for(table, "until Ctrl-C"));
  ASSERT_TRUE(wait_for(*camera, "until Ctrl-C"));
  Command run(demo_with_progress({"--no-emulators", "--duration", "60"}));
  ASSERT_TRUE(wait_until(run, [](const Progress& p) { return p.left > 10; })) << run.err();
  camera->signal(SIGKILL);
  camera.reset();
  ASSERT_TRUE(wait_until(run, [](const Progress& p) { return p.left_lost; })) << run.err();
  sleep_ms(1200);  // long enough away that the counts below are due
  camera = std::make_unique<Command>(rigor_words({"emulate", config("demo.yaml"), "--only", "left"}));
  const std::uint64_t before = progress(run).left;
  ASSERT_TRUE(wait_until(run, [&](const Progress& p) { return !p.left_lost && p.left > before + 5; }))
      << run.err();
  const double returned_s = progress(run).t_s;
  run.signal(SIGINT);
  const Said said = run.wait();
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(read_file(dir / "report/result.json")), left = channel(result, "left");
  EXPECT_GT(left["disconnected_cycles"], 300) << "the channel says lost while the camera is away";
  EXPECT_GE(left["health"]["reconnects"], 1);
  EXPECT_GT(left["lost_samples"], 4) << "what was missed is counted";
  // A late sample may stand between any two; that the camera is seen again after it was lost is what counts.
  bool was_lost = false, returned = false;
  for (const json& span : left["status"]) {
    was_lost = was_lost || span["status"] == "disconnected";
    returned = returned || (was_lost && span["status"] == "fresh");
  }
  EXPECT_TRUE(returned) << left["status"];
  const int ran = result["loop"]["cycles_run"].get<int>(),
            skipped = result["loop"]["cycles_skipped"].get<int>();
  // A second less where a busy machine held the loop up just then.
  EXPECT_GE(ran + skipped, 1000 * (returned_s - 1)) << "every cycle is accounted for";
  EXPECT_GT(ran, skipped) << "the loop goes on";
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

TEST_F(Runs, LeaveTheTurntableSafeOnCtrlC) {
  Command run(demo_with_progress({"--duration", "60"}));
  ASSERT_TRUE(wait_until(run, [](const Progress& p) { return p.t_s >= 1; })) << run.err();
  run.signal(SIGINT);
  const Said said = run.wait(std::chrono::seconds(20));
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(read_file(dir / "report/result.json"));
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
