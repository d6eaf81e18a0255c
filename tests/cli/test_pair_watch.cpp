// Pairs under watch in whole runs: a device that changes is found and named, told as an event and as
// diagnostics; the watch can be asked, acknowledged, and made to learn again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>
#include <thread>
#include <tuple>

#include "sensor-hal/record/ros2_messages.h"
#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

class PairWatchRuns : public ::testing::Test {
 protected:
  void SetUp() override { setenv("XDG_RUNTIME_DIR", dir.path().c_str(), 1); }
  void TearDown() override { unsetenv("XDG_RUNTIME_DIR"); }
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  static const json& watch_of(const json& result, const std::string& channel) {
    static const json none = json::object();
    for (const json& c : result["channels"])
      if (c["name"] == channel && c.contains("pair") && c["pair"].contains("watch"))
        return c["pair"]["watch"];
    ADD_FAILURE() << "no watch of " << channel;
    return none;
  }
  TempDir dir;
};

void expect_alarm(const json& watch, const std::string& parameter, double change, double tolerance) {
  ASSERT_EQ(watch["alarms"], 1) << watch.dump().substr(0, 300);
  EXPECT_EQ(watch["state"], "alarm");
  const json& a = watch["alarm"];
  EXPECT_EQ(a["parameter"], parameter) << watch["text"];
  EXPECT_NEAR(a["change"].get<double>(), change, tolerance) << watch["text"];
  EXPECT_LT(a["sigma"].get<double>(), std::abs(change) / 3) << watch["text"];
  EXPECT_NEAR(a["since_s"].get<double>(), 5, 0.41) << "the change came after 5 s, in windows of 0.2 s";
}

TEST_F(PairWatchRuns, FindAndNameWhatChangesInARunAlikeOnAnyNumberOfWorkers) {
  std::string bytes;
  for (const char* workers : {"1", "3"}) {
    const Said said = rigor({"run", config("rigs/pair-watch.yaml"), "--json", "--workers", workers,
                             "--duration", "6.4", "--record", file("run.mcap"), "--report", file("report")});
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    // The name is right; edges that are sharper than pixels put the number off (docs/pair-watch.md).
    expect_alarm(watch_of(result, "camera"), "mount y", 0.00873, 0.003);
    expect_alarm(watch_of(result, "scan"), "range bias", 0.02, 0.004);
    expect_alarm(watch_of(result, "table"), "rate bias", 0.1, 0.01);
    const std::string now = read_file(file("run.mcap"));
    if (bytes.empty()) bytes = now;
    EXPECT_TRUE(now == bytes) << "alarms and windows come in the same cycles";
  }
  // A check of the recording knows of the alarms, and when they came.
  const Said checked = rigor(
      {"check", file("run.mcap"), "--json", "--set",
       "expect=[{of: scan, alarm: true}, {of: scan, alarm: false}, {of: scan, alarm: false, until_s: 5}]"});
  EXPECT_EQ(checked.status, 1) << checked.err;
  const json expect = json::parse(checked.out)["expect"];
  ASSERT_EQ(expect.size(), 3U);
  EXPECT_TRUE(expect[0]["holds"]);
  EXPECT_FALSE(expect[1]["holds"]);
  EXPECT_NEAR(expect[1]["first_s"].get<double>(), 5.5, 0.5);
  EXPECT_TRUE(expect[2]["holds"]) << "the device changes after 5 s";
  // What the recording says.
  std::vector<std::string> alarms;
  for (const auto& m : messages_on<record::msg::Event>(file("run.mcap"), "/rigor/events"))
    if (m.kind == "pair_alarm") alarms.push_back(m.channel + " " + m.text);
  ASSERT_EQ(alarms.size(), 3u);
  EXPECT_THAT(alarms, ::testing::Contains(HasSubstr("scan: range bias has changed by +0.0")));
  std::size_t learning = 0, alarmed = 0;
  for (const auto& m : messages_on<record::msg::DiagnosticArray>(file("run.mcap"), "/diagnostics"))
    for (const auto& s : m.status) {
      if (s.hardware_id != "scan") continue;
      learning += s.level == 1, alarmed += s.level == 2;
      EXPECT_THAT(s.values,
                  ::testing::Contains(::testing::Field(&record::msg::KeyValue::key, "range bias [m]")));
    }
  EXPECT_EQ(learning, 19u) << "the twentieth window ends the baseline";
  EXPECT_GE(alarmed, 2u);
  const std::string page = read_file(file("report/index.html"));
  EXPECT_THAT(page, HasSubstr("scan: does the simulation still match?"));
  EXPECT_THAT(page, HasSubstr("range bias has changed by"));
}

TEST_F(PairWatchRuns, NameWhatChangesInOdometryAndReceivers) {
  const Said said = rigor({"run", config("rigs/pair-watch-navigation.yaml"), "--json", "--duration", "3800",
                           "--set", "channels.gnss.pair.watch.baseline_windows=40", "--set",
                           "channels.odometry.pair.real.faults=[{kind: bias, value: velocity_x, amount_mps: "
                           "0.02, from_s: 3600}]",
                           "--set",
                           "channels.gnss.pair.real.faults=[{kind: bias, value: east, amount_m: 0.2, from_s: "
                           "3600}]"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  for (const auto& [channel, parameter, change, sigmas] :
       {std::tuple{"odometry", "forward velocity bias", 0.02, 4.0},
        std::tuple{"gnss", "east bias", 0.2, 4.0}}) {
    const json& watch = watch_of(result, channel);
    ASSERT_EQ(watch["alarms"], 1) << watch.dump().substr(0, 300);
    const json& a = watch["alarm"];
    EXPECT_EQ(a["parameter"], parameter) << watch["text"];
    EXPECT_NEAR(a["change"].get<double>(), change, sigmas * a["sigma"].get<double>()) << watch["text"];
    EXPECT_LT(a["sigma"].get<double>(), change / 5) << watch["text"];
    EXPECT_EQ(a["since_s"], 3600) << watch["text"];
  }
}

/// A camera's sensor model with other numbers.
std::string camera_model_file(int width_px, double focal, double gain) {
  const double across = width_px;
  const auto text = [](double x) { return std::to_string(x); };
  return "width_px: " + std::to_string(width_px) + "\nheight_px: " + std::to_string(width_px * 3 / 4) +
         "\nexposure_us: 4000\nintrinsics: { fx_px: " + text(0.97 * across * focal) +
         ", cx_px: " + text(0.503 * across) + ", cy_px: " + text(0.372 * across) +
         " }\nlens: { k1: -0.22, k2: 0.08 }\noptics: { f_number: 4, "
         "transmission: " +
         std::to_string(0.8 * gain) +
         " }\nnoise: { full_well_e: 10500, read_noise_e: 6, dsnu_e: 2, prnu: 0.006, black_level_dn: 32, "
         "adc_bits: 12 }\n";
}

TEST_F(PairWatchRuns, NameFocalLengthGainAndNoiseOfACamera) {
  write_file(dir / "twin.yaml", camera_model_file(192, 1, 1));
  write_file(dir / "longer.yaml", camera_model_file(192, 1.01, 1));
  // Light and noise do not ask for that many pixels.
  write_file(dir / "coarse.yaml", camera_model_file(96, 1, 1));
  write_file(dir / "brighter.yaml", camera_model_file(96, 1, 1.1));
  const std::string worlds = config("worlds/testbed.yaml");
  const std::string mount = "T_world_sensor: { position_m: [0, -3, 1.4], look_at_m: [0, 2.5, 1.1] }";
  const auto device = [&](const std::string& sensor_model) {
    return "sensor: " + sensor_model + ", renderer: rays, " + mount;
  };
  const auto pair = [&](const std::string& name, const std::string& sensor_model, const std::string& change) {
    return "  " + name + ":\n    kind: image\n    rate_hz: 4\n    latency_ms: 100\n    pair:\n" +
           "      watch: { window_s: 0.25, baseline_windows: 20, false_alarms_per_h: 0.01 }\n" +
           "      real: { backend: simulated, " + device(sensor_model) + ", " + change + " }\n" +
           "      simulated: { backend: simulated, " + device(sensor_model) + " }\n";
  };
  write_file(
      dir / "rig.yaml",
      "name: planted\nclock: virtual\nduration_s: 6.75\nloop: { rate_hz: 20 }\n"
      "simulation: { world: " +
          worlds + ", workers: 2 }\nchannels:\n" +
          pair("focal", "twin.yaml", "model_schedule: [ { from_s: 5.5, " + device("longer.yaml") + " } ]") +
          pair("bright", "coarse.yaml",
               "model_schedule: [ { from_s: 5.5, " + device("brighter.yaml") + " } ]") +
          pair("noisy", "coarse.yaml", "faults: [ { kind: noise, sigma_dn: 4, from_s: 5.5 } ]"));
  const Said said = rigor({"run", file("rig.yaml"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  const auto alarm = [&](const char* channel) {
    const json& watch = watch_of(result, channel);
    EXPECT_EQ(watch["alarms"], 1) << channel;
    EXPECT_NEAR(watch.value("alarm", json::object()).value("since_s", 0.0), 5.5, 0.3) << watch["text"];
    return watch.value("alarm", json::object());
  };
  const json focal = alarm("focal"), bright = alarm("bright"), noisy = alarm("noisy");
  EXPECT_EQ(focal.value("parameter", ""), "focal length");
  EXPECT_NEAR(focal.value("change", 0.0), 0.01, 0.004);
  EXPECT_EQ(bright.value("parameter", ""), "gain");
  EXPECT_NEAR(bright.value("change", 0.0), 0.1, 0.01);
  EXPECT_EQ(noisy.value("parameter", "").substr(0, 5), "noise");
  EXPECT_GT(noisy.value("change", 0.0), 1);
}

TEST_F(PairWatchRuns, NameTheLightThatATimeOfFlightCameraHasLost) {
  const std::string sensor_model = config("sensors/watched-tof.yaml");
  std::string dim = read_file(sensor_model);
  dim.replace(dim.find("0.375"), 5, "0.3375");  // 10 % less light
  write_file(dir / "dim.yaml", dim);
  const auto device = [](const std::string& of) {
    return "sensor: " + of +
           ", renderer: rays, T_world_sensor: { position_m: [0.3, 0.9, 1.2], look_at_m: [0.9, 2.5, 0.7] }";
  };
  const auto pair = [&](const std::string& name, const std::string& change) {
    return "  " + name + ":\n    kind: range_image\n    rate_hz: 5\n    latency_ms: 80\n    pair:\n" +
           "      watch: { window_s: 0.2, baseline_windows: 32, false_alarms_per_h: 0.01 }\n" +
           "      real: { backend: simulated, " + device(sensor_model) + (change.empty() ? "" : ", ") +
           change + " }\n      simulated: { backend: simulated, " + device(sensor_model) + " }\n";
  };
  write_file(dir / "rig.yaml",
             "name: planted\nclock: virtual\nduration_s: 8.6\nloop: { rate_hz: 20 }\nsimulation: { world: " +
                 config("worlds/testbed.yaml") + ", workers: 2 }\nchannels:\n" +
                 pair("dim", "model_schedule: [ { from_s: 7, " + device("dim.yaml") + " } ]") +
                 pair("same", ""));
  const Said said = rigor({"run", file("rig.yaml"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  EXPECT_EQ(watch_of(result, "same")["alarms"], 0) << watch_of(result, "same")["text"];
  const json& watch = watch_of(result, "dim");
  ASSERT_EQ(watch["alarms"], 1);
  const json& a = watch["alarm"];
  EXPECT_EQ(a["parameter"], "amplitude") << watch["text"];
  EXPECT_NEAR(a["since_s"].get<double>(), 7, 0.21) << watch["text"];
  EXPECT_NEAR(a["change"].get<double>(), -0.1, 4 * a["sigma"].get<double>()) << watch["text"];
}

TEST_F(PairWatchRuns, AreQuietWhereNothingChanges) {
  const Said said =
      rigor({"run", config("rigs/pair-watch.yaml"), "--json", "--set", "channels.scan.pair.real.faults=[]",
             "--set", "channels.camera.pair.real.model_schedule=[]", "--set",
             "channels.table.pair.real.faults.2.from_s=100"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  for (const char* channel : {"camera", "scan", "table"}) {
    const json& watch = watch_of(result, channel);
    EXPECT_EQ(watch["alarms"], 0) << channel << ": " << watch["text"];
    EXPECT_EQ(watch["state"], "watching");
    EXPECT_GE(watch["windows"], 40);
  }
}

TEST_F(PairWatchRuns, CanBeAskedAcknowledgedAndMadeToLearnAgain) {
  // On the wall clock, with the scanner's pair alone.
  std::string rig = read_file(config("rigs/pair-watch.yaml"));
  const auto cut = [&](const std::string& from, const std::string& to) {
    const std::size_t i = rig.find(from);
    rig.erase(i, (to.empty() ? rig.size() : rig.find(to, i)) - i);
  };
  cut("  camera:", "  scan:");
  cut("  table:", "emulators:");
  cut("emulators:", "");
  const std::size_t at = rig.find("*watch");
  rig.replace(at, 6, "{ window_s: 0.1, baseline_windows: 16, false_alarms_per_h: 0.01 }");
  const std::filesystem::path configs = std::filesystem::path(config("demo.yaml")).parent_path();
  for (std::size_t i; (i = rig.find("../")) != std::string::npos;) rig.replace(i, 3, configs.string() + "/");
  for (std::size_t i = 0; (i = rig.find("from_s: 5", i)) != std::string::npos;)
    rig.replace(i, 9, "from_s: 3");
  write_file(dir / "scan.yaml", rig);
  const Command going(
      rigor_words({"run", file("scan.yaml"), "--clock", "wall", "--duration", "60", "--json"}));
  const auto ask = [](std::vector<std::string> words) {
    words.insert(words.begin(), "pair");
    words.emplace_back("--json");
    return json::parse(rigor(words).out, nullptr, false);
  };
  const std::string run = std::to_string(going.pid());
  json said;
  for (int i = 0; i < 900; ++i) {  // until there is an alarm: the machine may be busy
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    said = ask({run, "scan"});
    if (said.is_object() && said.contains("watch") && said["watch"]["state"] == "alarm") break;
  }
  ASSERT_TRUE(said.is_object() && said.contains("watch")) << going.err();
  ASSERT_EQ(said["watch"]["state"], "alarm") << said.dump().substr(0, 500);
  EXPECT_EQ(said["watch"]["alarm"]["parameter"], "range bias") << said["watch"]["text"];
  EXPECT_FALSE(said["watch"]["series"].empty());
  EXPECT_NE(ask({run, "scan", "--acknowledge"})["watch"]["state"], "learning");
  EXPECT_EQ(ask({run, "scan", "--learn-again"})["watch"]["state"], "learning");
  EXPECT_TRUE(ask({run}).contains("scan"));
  EXPECT_THAT(rigor({"pair", run, "scn"}).err, HasSubstr("did you mean 'scan'?"));
  EXPECT_EQ(rigor({"pair", run, "scan", "--acknowledge"}).status, 1) << "there is no alarm any more";
}

TEST_F(PairWatchRuns, MistakesAreToldWithTheirPlace) {
  const auto refused = [](std::vector<std::string> sets) {
    std::vector<std::string> words{"run", config("rigs/pair-watch.yaml"), "--duration", "0.1"};
    for (auto& s : sets) words.insert(words.end(), {"--set", s});
    const Said said = rigor(words);
    EXPECT_EQ(said.status, 2);
    return said.err;
  };
  EXPECT_THAT(refused({"channels.scan.pair.watch.windw_s=1"}),
              HasSubstr("expected baseline_windows, false_alarms_per_h, window_s"));
  EXPECT_THAT(refused({"channels.scan.pair.watch.baseline_windows=15"}),
              HasSubstr("channels.scan.pair.watch.baseline_windows"));
  EXPECT_THAT(refused({"channels.scan.pair.watch.window_s=0.01"}),
              HasSubstr("at least the channel's period, 0.1 s"));
  EXPECT_THAT(refused({"channels.table.pair.simulated.signals={position: {constant: 0}}"}),
              HasSubstr("expected the same numbers of both sides in the same order, got position, rate"));
}

}  // namespace
}  // namespace rigor::test
