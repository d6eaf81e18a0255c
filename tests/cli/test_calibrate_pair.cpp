// `rigor calibrate pair` as a user drives it: a device that has changed, the proposal, and the simulated side
// that has it.
#include <cmath>
#include <map>

#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

constexpr const char* kRig = R"(
name: pair
seed: 3
clock: virtual
loop: { rate_hz: 1000, overrun: skip }
simulation: { world: TESTBED, workers: 1 }
channels:
  scan:
    kind: point_cloud
    rate_hz: 25
    latency_ms: 30
    pair:
      active: real
      real: { backend: simulated, sensor: device.yaml, renderer: rays, T_world_sensor: { position_m: [0, -3, 0.4], roll_pitch_yaw_deg: [0, 0, 90.5] } }
      simulated: { backend: simulated, sensor: twin.yaml, renderer: rays, T_world_sensor: { position_m: [0, -3, 0.4], look_at_m: [0, 2.5, 0.4] } }
  single:
    kind: point_cloud
    backend: simulated
    rate_hz: 5
    latency_ms: 30
    sensor: twin.yaml
    renderer: rays
    T_world_sensor: { position_m: [0, -3, 0.4], look_at_m: [0, 2.5, 0.4] }
)";
constexpr const char* kSimulated = R"(
wavelength_nm: 905
scan: { rotation_hz: 50, start_deg: -135, end_deg: 135, step_deg: 0.5 }
range: { min_m: 0.5, max_m: 20, step_mm: 1, bias_mm: BIAS }
noise: { floor_mm: FLOOR, scale_mm: 1, exponent: 0.5 }
remission: { scale: 200, noise: 0.02, maximum: 254, step: 1 }
)";

std::string with(std::string text, const std::string& word, const std::string& value) {
  const auto at = text.find(word);
  return text.replace(at, word.size(), value);
}

class CalibratePair : public Calibrate {
 protected:
  void SetUp() override {
    write_file(dir / "rig.yaml", with(kRig, "TESTBED", config("worlds/testbed.yaml")));
    write_file(dir / "twin.yaml", with(with(kSimulated, "BIAS", "5"), "FLOOR", "6"));
    // 20 mm more, and noise doubled but for a part of it.
    write_file(dir / "device.yaml", with(with(kSimulated, "BIAS", "25"), "FLOOR", "12"));
  }
  /// What the run says of itself.
  json record(const std::string& name, const std::string& duration_s,
              std::vector<std::string> more = {}) const {
    std::vector<std::string> words{"run", "rig.yaml", "--duration", duration_s, "--record", name, "--json"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(words, dir.path());
    EXPECT_EQ(said.status, 0) << said.err;
    return json::parse(said.out, nullptr, false);
  }
  static double change(const json& j, const char* name, const char* what = "value") {
    return j["change"][name][what].get<double>();
  }
};

TEST_F(CalibratePair, AProposalClosesTheLoop) {
  record("before.mcap", "2");
  const json j =
      answer({"pair", "before.mcap", "--channel", "scan", "-o", "proposed.yaml", "--report", "report"});
  expect_report("report", "Model of a pair");
  EXPECT_EQ(j["pairs"], 50);
  EXPECT_NEAR(change(j, "range_bias_m"), 0.020, 4 * change(j, "range_bias_m", "sigma"));
  EXPECT_LT(change(j, "range_bias_m", "sigma"), 0.004);
  EXPECT_NEAR(change(j, "mount_z_rad"), 0.5 * M_PI / 180, 4 * change(j, "mount_z_rad", "sigma"));
  EXPECT_NEAR(change(j, "noise_factor"), 1.95, 0.12);
  EXPECT_TRUE(j["mount"]["changed"].get<bool>());
  EXPECT_EQ(j["mount"]["key"], "channels.scan.pair.simulated.T_world_sensor");
  const auto sensor_model = load_lidar_model(dir / "proposed.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
  EXPECT_DOUBLE_EQ(sensor_model->range.bias_m * 1e3,
                   j["parameters"]["range_bias_m"]["value"].get<double>() * 1e3);
  EXPECT_THAT(read_file(dir / "proposed.yaml"), HasSubstr("before.mcap"));

  const std::string mount =
      j["mount"]["key"].get<std::string>() + "=" + j["mount"]["value"].get<std::string>();
  const json run =
      record("after.mcap", "4",
             {"--set", "channels.scan.pair.simulated.sensor=proposed.yaml", "--set", mount, "--set", "seed=4",
              "--set", "channels.scan.pair.watch={ window_s: 0.08, baseline_windows: 24 }"});
  const json k = answer({"pair", "after.mcap", "--channel", "scan"});
  for (const char* name : {"range_bias_m", "range_scale", "mount_z_rad", "mount_move_x_m", "mount_move_y_m"})
    // Both recordings are uncertain.
    EXPECT_NEAR(change(k, name), 0, 4 * std::hypot(change(k, name, "sigma"), change(j, name, "sigma")))
        << name;
  EXPECT_NEAR(change(k, "noise_factor"), 1, 0.08);
  EXPECT_LT(std::abs(k["mean_before"].get<double>()), 0.1 * std::abs(j["mean_before"].get<double>()));

  // The watch of that run: silent, and its baseline says of each change that there is none.
  ASSERT_TRUE(run.contains("channels"));
  const json& watch = run["channels"][0]["pair"]["watch"];
  EXPECT_EQ(watch["alarms"], 0) << watch["text"];
  EXPECT_GE(watch["windows"], 45);
  const std::map<std::string, std::string> proposed{{"range bias", "range_bias_m"},
                                                    {"range scale", "range_scale"},
                                                    {"mount z", "mount_z_rad"},
                                                    {"mount move x", "mount_move_x_m"},
                                                    {"mount move y", "mount_move_y_m"}};
  std::size_t looked_at = 0;
  for (const json& p : watch["parameters"]) {
    const auto name = proposed.find(p["name"]);
    if (name == proposed.end()) continue;
    const double of_baseline = p["scatter"].get<double>() / std::sqrt(24);
    EXPECT_LT(std::abs(p["mean"].get<double>()),
              4 * std::hypot(of_baseline, change(j, name->second.c_str(), "sigma")))
        << name->first << " " << p["mean"] << " ± " << of_baseline;
    ++looked_at;
  }
  EXPECT_EQ(looked_at, proposed.size());
}

TEST_F(CalibratePair, WrongInputIsRefused) {
  const std::string board = CalibrationRecordings::get().board(), wall = CalibrationRecordings::get().wall();
  expect_refused({"pair", "nothing.mcap", "--channel", "left"}, {"nothing.mcap", "no such file"});
  expect_refused({"pair", wall, "--channel", "tof"}, {"wall.mcap", "pair", "tof"});
  expect_refused({"pair", board, "--channel", "lefft"}, {"lefft", "left"});
  expect_refused({"pair", board, "--channel", "top"}, {"channel top is none", "left"});
  expect_refused({"pair", board, "--channel", "left", "--model", "best"}, {"--model", "principal-point"});
  expect_refused({"pair", board, board}, {"one recording", "got 2"});
  write_file(dir / "text.mcap", "this is no recording");
  expect_refused({"pair", "text.mcap"}, {"text.mcap"});
  record("short.mcap", "0.2");
  expect_refused({"pair", "short.mcap", "--channel", "scan", "-o", "x.yaml"},
                 {"short.mcap", "expected 8 samples"});
  write_file(dir / "taken.yaml", "x");
  expect_refused({"pair", board, "--channel", "left", "-o", "taken.yaml"}, {"taken.yaml", "--force"});
}

// 20 mm that come after two of five seconds: neither 0, nor 20, nor something between is proposed unasked.
TEST_F(CalibratePair, ADeviceThatChangesWhileItIsRecordedIsRefusedAndEachPartIsFitted) {
  write_file(dir / "twin.yaml", with(with(kSimulated, "BIAS", "5"), "FLOOR", "6"));
  write_file(dir / "device.yaml", with(with(kSimulated, "BIAS", "5"), "FLOOR", "6"));
  write_file(dir / "changed.yaml", with(with(kSimulated, "BIAS", "25"), "FLOOR", "6"));
  record("across.mcap", "5",
         {"--set",
          "channels.scan.pair.real.T_world_sensor={ position_m: [0, -3, 0.4], look_at_m: [0, 2.5, 0.4] }",
          "--set",
          "channels.scan.pair.real.model_schedule=[{ from_s: 2, sensor: changed.yaml, renderer: rays, "
          "T_world_sensor: { "
          "position_m: [0, -3, 0.4], look_at_m: [0, 2.5, 0.4] } }]"});
  const std::vector<std::string> words{"calibrate", "pair", "across.mcap", "--channel", "scan"};
  const auto with_words = [&](std::vector<std::string> more) {
    std::vector<std::string> all = words;
    all.insert(all.end(), more.begin(), more.end());
    return rigor(all, dir.path());
  };
  const Said refused = with_words({"-o", "new.yaml"});
  EXPECT_EQ(refused.status, 2) << refused.out;
  EXPECT_THAT(refused.err, HasSubstr("range bias has changed by +0.0"));
  EXPECT_THAT(refused.err, HasSubstr("--until "));
  EXPECT_FALSE(std::filesystem::exists(dir / "new.yaml"));
  // The instants that it names are good ones.
  const auto named = [&](const std::string& option) {
    return std::stod(refused.err.substr(refused.err.find(option) + option.size()));
  };
  EXPECT_NEAR(named("--until "), 2, 0.3);
  EXPECT_NEAR(named("--from "), 2, 0.3);
  const json before =
      answer({"pair", "across.mcap", "--channel", "scan", "--until", std::to_string(named("--until "))});
  EXPECT_NEAR(change(before, "range_bias_m"), 0, 4 * change(before, "range_bias_m", "sigma"));
  const json after =
      answer({"pair", "across.mcap", "--channel", "scan", "--from", std::to_string(named("--from "))});
  EXPECT_NEAR(change(after, "range_bias_m"), 0.020, 4 * change(after, "range_bias_m", "sigma"));
  // Who wants all of it gets it, and is told.
  const json all = answer({"pair", "across.mcap", "--channel", "scan", "--from", "0"});
  EXPECT_THAT(all["warnings"].dump(), HasSubstr("averages across it"));
  EXPECT_EQ(with_words({"--from", "3", "--until", "2"}).status, 2);
  EXPECT_EQ(with_words({"--from", "30"}).status, 2);
}

}  // namespace
}  // namespace rigor::test
