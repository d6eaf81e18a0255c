// Faults in whole runs: in the rig, injected by `rigor fault`, recorded, run again and replayed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "sensor-hal/record/ros2_messages.h"
#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

void sleep_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

class Faults : public ::testing::Test {
 protected:
  // Sockets of these runs are not to be found by others.
  void SetUp() override { setenv("XDG_RUNTIME_DIR", dir.path().c_str(), 1); }
  void TearDown() override { unsetenv("XDG_RUNTIME_DIR"); }
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  [[nodiscard]] json run(std::vector<std::string> more) const {
    std::vector<std::string> words{"run", config("rigs/faults.yaml"), "--json", "--report", file("report")};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(std::move(words));
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out) : json();
  }
  static json faults_of(const json& result, const std::string& channel) {
    for (const json& c : result.value("faults", json::array()))
      if (c["channel"] == channel) return c;
    ADD_FAILURE() << "no faults of " << channel;
    return {};
  }
  /// What a run of this rig says on its socket; empty object where there is none yet.
  static json ask(const std::vector<std::string>& words, int* status = nullptr) {
    std::vector<std::string> all{"fault"};
    all.insert(all.end(), words.begin(), words.end());
    all.emplace_back("--json");
    const Said said = rigor(all);
    if (status) *status = said.status;
    return json::parse(said.out, nullptr, false);
  }
  TempDir dir;
};

void expect_accounted(const json& channel) {
  EXPECT_EQ(channel["taken"].get<std::uint64_t>(),
            channel["handed_on"].get<std::uint64_t>() + channel["dropped"].get<std::uint64_t>() +
                channel["disconnected"].get<std::uint64_t>() + channel["no_slot"].get<std::uint64_t>() +
                channel["waiting"].get<std::uint64_t>())
      << channel;
}

TEST_F(Faults, OfARigRepeatByteForByteOnAnyNumberOfWorkersAndAreReplayed) {
  std::string first, seen;
  for (const char* workers : {"1", "4", "1"}) {
    const json result =
        run({"--clock", "virtual", "--record", file("run.mcap"), "--workers", workers, "--set",
             "channels.right.faults.0.from_s=0.2", "--set", "channels.right.faults.1.from_s=0.4", "--set",
             "channels.left.pair.real.faults.0.from_s=0.1", "--set",
             "channels.left.pair.real.faults.1={kind: noise, sigma_dn: 20}", "--set",
             "sinks.table_command.faults.0.from_s=0", "--duration", "1.6"});
    ASSERT_FALSE(result.is_null());
    const std::string bytes = read_file(dir / "run.mcap");
    if (first.empty()) first = bytes, seen = result["input_sha256"];
    EXPECT_EQ(result["input_sha256"], seen);
    EXPECT_TRUE(bytes == first) << workers << " workers";
    const json right = faults_of(result, "right");
    EXPECT_GT(right["dropped"], 0);
    EXPECT_GT(right["faults"][0]["seen"], 10);
    EXPECT_EQ(right["dropped"], right["faults"][0]["dropped"]);
    expect_accounted(right);
    const json left = faults_of(result, "left.real");
    EXPECT_GT(left["faults"][1]["changed"], 20);
    expect_accounted(left);
    expect_accounted(faults_of(result, "turntable"));
    EXPECT_GT(faults_of(result, "turntable")["faults"][0]["delayed"], 100);
    EXPECT_GT(faults_of(result, "table_command")["faults"][0]["dropped"], 0);
  }
  const std::string page = read_file(dir / "report/index.html");
  EXPECT_THAT(page, AllOf(HasSubstr("<h2>Faults</h2>"), HasSubstr("burst_loss"), HasSubstr("left.real")));
  // A replay shows what the application saw, and adds no faults to it.
  const Said replay = rigor({"replay", file("run.mcap"), "--json"});
  ASSERT_EQ(replay.status, 0) << replay.err;
  const json replayed = json::parse(replay.out);
  EXPECT_EQ(replayed["input_sha256"], seen);
  EXPECT_FALSE(replayed.contains("faults"));
}

TEST_F(Faults, ThatAreWrongInTheRigAreRefusedBeforeAnythingIsTouched) {
  const auto refused = [&](const std::string& set) {
    const Said said = rigor({"run", config("rigs/faults.yaml"), "--clock", "virtual", "--record",
                             file("no.mcap"), "--report", file("none"), "--set", set});
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_FALSE(std::filesystem::exists(dir / "no.mcap"));
    return said.err;
  };
  EXPECT_THAT(refused("channels.right.faults.0.kind=dorp"), HasSubstr("did you mean 'drop'?"));
  EXPECT_THAT(refused("channels.turntable.faults.0={kind: corrupt}"), HasSubstr("can have"));
  EXPECT_THAT(refused("channels.right.faults.2.when.channel=turntabel"),
              HasSubstr("did you mean 'turntable'?"));
  EXPECT_THAT(refused("channels.left.faults=[{kind: drop}]"), HasSubstr("pair.real.faults"));
  EXPECT_THAT(refused("sinks.table_command.faults.0.probability=2"),
              HasSubstr("faults.0.probability: expected a number from 0 to 1, got 2"));
}

/// A rig of one replayed channel, which runs on the wall clock without devices.
constexpr const char* kSmallRig =
    "name: small\n"
    "seed: 3\n"
    "loop: { rate_hz: 1000, fifo_priority: 0, lock_memory: false, dma_latency: false }\n"
    "simulation: { world: WORLD }\n"
    "channels:\n"
    "  eye: { kind: image, backend: simulated, rate_hz: 20, latency_ms: 100, sensor: SENSOR,\n"
    "    T_world_sensor: { position_m: [0.2, -3.0, 1.6], look_at_m: [0, 0, 0.4] } }\n";

std::string small_rig() {
  std::string text = kSmallRig;
  for (const auto& [word, with] :
       {std::pair<std::string, std::string>{"WORLD", config("worlds/turntable.yaml")},
        {"SENSOR", config("sensors/demo-camera.yaml")}})
    text.replace(text.find(word), word.size(), with);
  return text;
}

TEST_F(Faults, AreInjectedWhileARunGoesOnListedClearedAndComeAgain) {
  write_file(dir / "small.yaml", small_rig());
  Command going(
      rigor_words({"run", file("small.yaml"), "--duration", "60", "--record", file("live.mcap"), "--json"}));
  json channels;
  for (int i = 0; i < 200 && going.running(); ++i, sleep_ms(50)) {
    channels = ask({"small"});
    if (channels.is_object() && channels.contains("channels") && channels["channels"][0]["received"] > 3)
      break;
  }
  ASSERT_TRUE(channels.is_object() && channels.contains("channels")) << going.err();
  EXPECT_EQ(channels["channels"][0]["name"], "eye");
  EXPECT_EQ(channels["faults_at"][0]["values"][0]["unit"], "dn");

  // Nobody else may talk to it.
  struct stat s {};
  const auto socket_file = dir / ("rigor/small." + std::to_string(going.pid()) + ".sock");
  ASSERT_EQ(stat(socket_file.c_str(), &s), 0) << socket_file;
  EXPECT_EQ(s.st_mode & 0777, 0600u);
  ASSERT_EQ(stat((dir / "rigor").c_str(), &s), 0);
  EXPECT_EQ(s.st_mode & 0777, 0700u);

  int status = -1;
  EXPECT_EQ(ask({"small", "eye", "drop", "probability=0.5", "--for", "1"}, &status)["index"], 0);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(ask({std::to_string(going.pid()), "eye", "bias", "amount_dn=40"})["index"], 1);
  EXPECT_THAT(ask({"small", "eye", "dorp"}, &status).dump(), HasSubstr("did you mean 'drop'?"));
  EXPECT_EQ(status, 2);
  EXPECT_THAT(ask({"small", "ey", "drop"}, &status).dump(), HasSubstr("did you mean 'eye'?"));
  EXPECT_EQ(status, 2);
  EXPECT_THAT(ask({"other", "eye", "drop"}, &status).dump(), HasSubstr("running now: small"));
  EXPECT_EQ(status, 2);
  sleep_ms(1500);
  const json listed = ask({"small", "--list"});
  ASSERT_EQ(listed[0]["faults"].size(), 2u) << listed;
  EXPECT_EQ(listed[0]["faults"][0]["over"], true);
  EXPECT_EQ(listed[0]["faults"][1]["on"], true);
  ask({"small", "--clear", "eye"}, &status);
  EXPECT_EQ(status, 0);
  going.signal(SIGINT);
  const Said said = going.wait();
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_FALSE(std::filesystem::exists(socket_file)) << "it goes with the run";
  const json result = json::parse(said.out), eye = faults_of(result, "eye");
  expect_accounted(eye);
  EXPECT_EQ(eye["faults"][1]["fault"], json::parse(R"({"kind": "bias", "amount_dn": 40})"));
  const auto told = messages_on<record::msg::Fault>(file("live.mcap"), "/rigor/faults");
  ASSERT_EQ(told.size(), 4u) << "two begin, two end";
  for (const std::size_t i : {0, 1}) {
    const json& f = eye["faults"][i];
    const auto ends = std::ranges::find_if(
        told, [&](const record::msg::Fault& m) { return m.index == f["index"] && !m.begins; });
    ASSERT_NE(ends, told.end());
    EXPECT_EQ(ends->channel, "eye");
    EXPECT_TRUE(ends->live);
    EXPECT_EQ(ends->kind, f["kind"]);
    EXPECT_EQ(json::parse(ends->fault), f["fault"]);
    EXPECT_EQ(ends->seen, f["seen"]);
    EXPECT_EQ(ends->dropped, f["dropped"]);
    EXPECT_EQ(ends->changed, f["changed"]);
  }
  const json span = eye["faults"][0]["spans"].at(0);
  EXPECT_GE(span[1].get<double>() - span[0].get<double>(), 0.999)
      << "its second, and cycles that a busy machine skipped";
  EXPECT_GT(eye["faults"][0]["seen"], 0);
  EXPECT_EQ(eye["faults"][1]["over"], true);
  EXPECT_GT(eye["faults"][1]["changed"], 10);

  // What the recording says makes the same faults of a run in virtual time: the same instants, the same
  // draws.
  const std::string duration = std::to_string(std::lround(result["duration_s"].get<double>()) + 1);
  const auto again = [&](const std::string& record) {
    const Said virtual_run = rigor({"run", file("small.yaml"), "--clock", "virtual", "--duration", duration,
                                    "--faults-from", file("live.mcap"), "--record", record, "--json"});
    EXPECT_EQ(virtual_run.status, 0) << virtual_run.err;
    return virtual_run.status == 0 ? json::parse(virtual_run.out) : json();
  };
  const json one = again(file("one.mcap"));
  ASSERT_FALSE(one.is_null());
  const json again_eye = faults_of(one, "eye");
  for (const std::size_t i : {0, 1}) {
    EXPECT_EQ(again_eye["faults"][i]["spans"], eye["faults"][i]["spans"]) << i;
    EXPECT_EQ(again_eye["faults"][i]["text"], eye["faults"][i]["text"]);
    EXPECT_EQ(again_eye["faults"][i]["fault"], eye["faults"][i]["fault"]);
    EXPECT_EQ(again_eye["faults"][i]["live"], true);
  }
  // And a run of that recording again is the same file.
  const std::string bytes = read_file(dir / "one.mcap");
  std::filesystem::copy(dir / "one.mcap", dir / "live.mcap",
                        std::filesystem::copy_options::overwrite_existing);
  again(file("two.mcap"));
  EXPECT_TRUE(read_file(dir / "two.mcap") == bytes);
}

TEST_F(Faults, AreNotTakenFromARecordingOfAnotherRigOrWithoutThem) {
  write_file(dir / "small.yaml", small_rig());
  write_file(dir / "other.yaml",
             "name: other\nclock: virtual\nduration_s: 0.1\nrecord: { file: " + file("other.mcap") +
                 " }\nsinks:\n  lamp: { backend: log, signals: [on] }\n");
  const Said made = rigor({"run", file("other.yaml"), "--json"});
  ASSERT_EQ(made.status, 0) << made.err;
  const Said other = rigor({"run", file("small.yaml"), "--clock", "virtual", "--duration", "0.1",
                            "--faults-from", file("other.mcap")});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err,
              HasSubstr("expected a recording of this rig (small), got one of other: here is no sink lamp"));
  const Said none =
      rigor({"run", file("other.yaml"), "--record", file("none.mcap"), "--faults-from", file("other.mcap")});
  EXPECT_EQ(none.status, 2);
  EXPECT_THAT(none.err, HasSubstr("expected a recording of a run into which faults were injected"));
}

TEST_F(Faults, NoRunIsDisturbedByWhoeverTalksNonsenseToIt) {
  write_file(dir / "small.yaml", small_rig());
  Command going(rigor_words({"run", file("small.yaml"), "--duration", "60", "--json"}));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string path = file("rigor/small." + std::to_string(going.pid()) + ".sock");
  ASSERT_LT(path.size(), sizeof address.sun_path);
  std::copy(path.begin(), path.end(), address.sun_path);
  const auto dial = [&] {
    const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    for (int i = 0; i < 400 && going.running(); ++i, sleep_ms(25))
      if (connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return fd;
    close(fd);
    return -1;
  };
  const int fd = dial();
  ASSERT_GE(fd, 0);
  std::string replies;
  const auto say = [&](const std::string& text) { (void)!send(fd, text.data(), text.size(), MSG_NOSIGNAL); };
  say("\n{}\nnonsense\n{\"command\": 3}\n{\"command\": \"flt\"}\n{\"command\": \"fault\", \"fault\": []}\n"
      "{\"command\": \"fault\", \"channel\": 7, \"fault\": {\"kind\": \"drop\"}}\n"
      "{\"command\": \"fault\", \"channel\": \"eye\", \"fault\": {\"kind\": {\"a\": 1}}}\n"
      "{\"command\": \"switch\", \"channel\": \"eye\", \"active\": \"real\"}\n{\"command\": \"run\"}\n");
  while (std::count(replies.begin(), replies.end(), '\n') < 10) {
    char buffer[4096];
    const ssize_t n = recv(fd, buffer, sizeof buffer, 0);
    ASSERT_GT(n, 0) << replies;
    replies.append(buffer, static_cast<std::size_t>(n));
  }
  std::istringstream lines(replies);
  std::string line;
  for (int i = 0; i < 9 && std::getline(lines, line); ++i) EXPECT_EQ(json::parse(line)["ok"], false) << line;
  std::getline(lines, line);
  EXPECT_EQ(json::parse(line)["result"]["rig"], "small");
  // A line without end, and clients that hang up or never read.
  const int rude = dial();
  const std::string endless(200'000, 'x');
  (void)!send(rude, endless.data(), endless.size(), MSG_NOSIGNAL);
  close(rude);
  for (int i = 0; i < 30; ++i) close(dial());
  close(fd);
  going.signal(SIGINT);
  const Said said = going.wait();
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_FALSE(json::parse(said.out).contains("faults"));
}

}  // namespace
}  // namespace rigor::test
