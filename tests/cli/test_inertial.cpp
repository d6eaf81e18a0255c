// Inertial units, satellite receivers and odometry by the command: what they tell on a circle that is known.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

using nlohmann::json;

const std::string kSensorModels = rigor::test::source_dir() + "/configs/sensors/";
/// A circle of 2 m about the origin at 0.4 rad/s, x of the sensor along it.
const char* const kCircle =
    "T_world_sensor: { position_m: [2, 0, 0.5], roll_pitch_yaw_deg: [0, 0, 90] }, "
    "motion: { velocity_m_per_s: [0, 0.8, 0], yaw_rate_deg_per_s: 22.918311805232928 }";

class Inertial : public ::testing::Test {
 protected:
  Inertial() {
    write_file(dir_ / "world.yaml",
               "rigor_world: 1\nnext_id: 4\nnodes:\n"
               "  - { id: 1, type: Place, attributes: { latitude_deg: 50.4, longitude_deg: 6.5, height_m: "
               "600 } }\n");
    write_file(dir_ / "nowhere.yaml",
               "rigor_world: 1\nnext_id: 4\nnodes:\n"
               "  - { id: 1, type: Frame, attributes: { name: mast, pose: [1, 0, 0, 3, 0, 1, 0, 0, 0, 0, 1, "
               "2] } }\n");
  }
  void rig(const std::string& channels, const std::string& world = "world.yaml") {
    write_file(dir_ / "rig.yaml",
               "name: rig\nseed: 1\nclock: virtual\nduration_s: 2\nloop: { rate_hz: 1000 }\n"
               "simulation: { world: " +
                   world + ", workers: 1 }\nchannels:\n" + channels);
  }
  static std::string channel(const std::string& kind, const std::string& sensor_model,
                             const std::string& more, int rate_hz = 100) {
    return "  it: { kind: " + kind +
           ", backend: simulated, latency_ms: 5, rate_hz: " + std::to_string(rate_hz) +
           ", sensor: " + kSensorModels + sensor_model + ", " + more + " }\n";
  }
  Said sense(const std::vector<std::string>& more = {}, const std::string& output = "out.json") {
    std::vector<std::string> words{"sense", (dir_ / "rig.yaml").string(), "--channel", "it",
                                   "-o",    (dir_ / output).string(),     "--json",    "--force"};
    words.insert(words.end(), more.begin(), more.end());
    return rigor(words, dir_.path());
  }
  json sample(const std::vector<std::string>& more = {}) {
    const Said said = sense(more);
    EXPECT_EQ(said.status, 0) << said.err << said.out;
    std::ifstream file(dir_ / "out.json");
    json read = json::parse(file);
    EXPECT_EQ(read, json::parse(said.out)["sample"]);
    return read;
  }
  void expect_refused(const std::string& what, const std::string& output = "out.json") {
    const Said said = sense({}, output);
    EXPECT_EQ(said.status, 2) << said.out;
    EXPECT_NE((said.out + said.err).find(what), std::string::npos) << said.out << said.err;
    EXPECT_NE((said.out + said.err).find("rig.yaml:"), std::string::npos)
        << "without its place: " << said.out;
  }
  TempDir dir_;
};

TEST_F(Inertial, UnitOnACircleFeelsItsWay) {
  rig(channel("imu", "imu-mems.yaml", std::string(kCircle) + ", gravity_mps2: 9.81"));
  const json s = sample({"--ideal", "--at", "1.23"});
  // To the middle, which is on its left.
  EXPECT_NEAR(s["specific_force_mps2"][0].get<double>(), 0, 1e-9);
  EXPECT_NEAR(s["specific_force_mps2"][1].get<double>(), 0.4 * 0.4 * 2, 1e-9);
  EXPECT_NEAR(s["specific_force_mps2"][2].get<double>(), 9.81, 1e-9);
  EXPECT_NEAR(s["angular_rate_radps"][2].get<double>(), 0.4, 1e-9);
  const json real = sample({"--at", "1.23"});
  EXPECT_GT(std::abs(real["angular_rate_radps"][2].get<double>() - 0.4), 1e-4) << "its bias";
  EXPECT_LT(std::abs(real["angular_rate_radps"][2].get<double>() - 0.4), 0.1);
  EXPECT_EQ(real, sample({"--at", "1.23"}));
}

TEST_F(Inertial, UnitOnANodeOfTheWorldRests) {
  rig(channel("imu", "imu-mems.yaml",
              "parent: mast, T_parent_sensor: { position_m: [0, 0, 1], roll_pitch_yaw_deg: [180, 0, 0] }"),
      "nowhere.yaml");
  const json s = sample({"--ideal"});
  EXPECT_NEAR(s["specific_force_mps2"][2].get<double>(), -9.80665, 1e-6) << "upside down";
  EXPECT_NEAR(s["angular_rate_radps"][0].get<double>(), 0, 1e-9);
}

TEST_F(Inertial, GravityIsThatOfThePlace) {
  rig(channel("imu", "imu-mems.yaml", kCircle));
  EXPECT_NEAR(sample({"--ideal"})["specific_force_mps2"][2].get<double>(), 9.8092, 2e-4);
}

TEST_F(Inertial, ReceiverTellsItsPlaceOnTheEarth) {
  rig(channel("nav_fix", "gnss-rtk.yaml", kCircle, 10));
  const json s = sample({"--ideal", "--at", "1"});
  // 2 m at 0.4 rad, from 50.4° north at 600 m: 111.25 km to a degree of latitude, 71.106 of longitude.
  EXPECT_NEAR((s["latitude_deg"].get<double>() - 50.4) * 111'258, 2 * std::sin(0.4), 1e-3);
  EXPECT_NEAR((s["longitude_deg"].get<double>() - 6.5) * 71'106, 2 * std::cos(0.4), 1e-3);
  EXPECT_NEAR(s["height_m"].get<double>(), 600.5, 1e-5);
  EXPECT_EQ(s["status"], "rtk_fixed");
  EXPECT_NEAR(sample({"--at", "1"})["height_m"].get<double>(), 600.5, 0.2);
}

TEST_F(Inertial, OdometryAddsUpTheWholeWay) {
  rig(channel("odometry", "odometry-skid-steer.yaml", kCircle, 50));
  const json s = sample({"--ideal", "--at", "2"});
  // In the frame where it stood: forward x, the middle at y = 2.
  EXPECT_NEAR(s["T_odom_base"]["position_m"][0].get<double>(), 2 * std::sin(0.8), 1e-9);
  EXPECT_NEAR(s["T_odom_base"]["position_m"][1].get<double>(), 2 - 2 * std::cos(0.8), 1e-9);
  EXPECT_NEAR(s["velocity_mps"][0].get<double>(), 0.8, 1e-9);
  EXPECT_NEAR(s["turn_rate_radps"][2].get<double>(), 0.4, 1e-9);
}

TEST_F(Inertial, RefusesWhatDoesNotFit) {
  rig(channel("imu", "gnss-rtk.yaml", kCircle));
  expect_refused("expected the sensor model of an inertial unit");
  rig(channel("nav_fix", "gnss-rtk.yaml", kCircle, 10), "nowhere.yaml");
  expect_refused("origin");
  rig(channel("odometry", "odometry-skid-steer.yaml", "phase_us: 0"));
  expect_refused("platform, wheels and motion");
  rig(channel("odometry", "odometry-skid-steer.yaml", "wheels: { left: a, right: b }"));
  expect_refused("expected a hinged node");
  rig(channel("point_cloud", "imu-mems.yaml", kCircle));
  expect_refused("an inertial unit: give one", "out.pcd");
  rig(channel("imu", "imu-mems.yaml", kCircle));
  EXPECT_EQ(sense({}, "out.png").status, 2);
  EXPECT_EQ(sense({"--truth", (dir_ / "t.exr").string()}).status, 2);
}

TEST_F(Inertial, RunsRepeatAndAreReplayedExactly) {
  const std::string rig_file = rigor::test::source_dir() + "/configs/rigs/inertial.yaml";
  const auto run = [&](const std::string& name, const std::string& workers) {
    const Said said = rigor({"run", rig_file, "--duration", "3", "--set", "simulation.workers=" + workers,
                             "--record", (dir_ / name).string(), "--json"},
                            dir_.path());
    EXPECT_EQ(said.status, 0) << said.err << said.out;
    return json::parse(said.out)["input_sha256"];
  };
  const json one = run("a.mcap", "1");
  EXPECT_EQ(one, run("b.mcap", "3"));
  const Said replayed = rigor({"replay", (dir_ / "a.mcap").string(), "--json"}, dir_.path());
  ASSERT_EQ(replayed.status, 0) << replayed.err;
  EXPECT_EQ(json::parse(replayed.out)["input_sha256"], one);
}

}  // namespace
}  // namespace rigor::test
