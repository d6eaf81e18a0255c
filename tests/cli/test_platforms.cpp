// Platforms in whole runs: commands, rides, buses, trees that fall.
#include "bench/motion/platforms.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <numbers>

#include "bench/run/assembly.h"
#include "bench/run/bench_run.h"
#include "builtin/registry.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sim/platform/ground.h"
#include "sim/platform/harvester.h"
#include "sim/platform/platform_yaml.h"
#include "sim/world/pose.h"
#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor {
namespace {

const std::string kSource = rigor::test::source_dir();

/// A room with a wall at x = 5, and a tree.
const char* const kWorld = R"(
rigor_world: 1
next_id: 10
nodes:
  - { id: 1, type: Material, attributes: { name: wall, reflectance: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5] } }
  - { id: 2, type: GroundPlane, attributes: { name: ground, half_extent_m: 40, cell_m: 1 }, edges: { made_of: [1] } }
  - { id: 3, type: Body, attributes: { name: wall-east, size_m: [0.2, 60, 6], pose: [1, 0, 0, 5.1, 0, 1, 0, 0, 0, 0, 1, 2] },
      edges: { made_of: [1] } }
)";

std::string platform(const std::string& more = "") {
  return "  platforms:\n    robot: { kind: skid-steer, model: " + kSource +
         "/configs/platforms/seekurjr.yaml, T_world_start: { position_m: [-2, 1], yaw_deg: 0 }" + more +
         " }\n";
}
const char* const kScript = R"(application:
  name: script
  sinks:
    drive:
      rate_hz: 20
      steps:
        - { at_s: 0, values: [0.5, 0] }
        - { at_s: 1.5, values: [0.4, 0.5] }
        - { at_s: 3, values: [0, 0] }
)";
const char* const kDrive =
    "sinks:\n  drive: { backend: simulated, platform: robot, latency_ms: 11, signals: [v, w] }\n";

class Platforms : public ::testing::Test {
 protected:
  Platforms() { test::write_file(dir / "world.yaml", kWorld); }
  std::unique_ptr<Assembly> make(const std::string& rig, int workers = 1) {
    test::write_file(dir / "rig.yaml",
                     "name: rig\nseed: 5\nclock: virtual\nduration_s: 4\nloop: { rate_hz: 1000 }\n"
                     "simulation:\n  world: world.yaml\n  workers: " +
                         std::to_string(workers) + "\n" + rig);
    auto config = load_rig(dir / "rig.yaml", {});
    if (!config) {
      ADD_FAILURE() << config.error().text();
      return nullptr;
    }
    auto assembly = assemble(std::move(*config), make_registry());
    if (!assembly) {
      ADD_FAILURE() << assembly.error().text();
      return nullptr;
    }
    return std::move(*assembly);
  }
  std::string error_of(const std::string& rig) {
    test::write_file(dir / "rig.yaml",
                     "name: rig\nclock: virtual\nduration_s: 1\nsimulation:\n  world: world.yaml\n" + rig);
    auto config = load_rig(dir / "rig.yaml", {});
    if (!config) return config.error().text();
    auto assembly = assemble(std::move(*config), make_registry());
    return assembly ? "" : assembly.error().text();
  }
  /// Runs it in virtual time; the digest of all that was seen.
  static std::string run(Assembly& assembly) {
    BenchRun bench(assembly.parts, nullptr);
    bench.want_digest(true);
    if (auto s = bench.arm(); !s) {
      ADD_FAILURE() << s.error().text();
      return "";
    }
    StopSource stop;
    auto outcome = bench.run(stop.token());
    if (!outcome) {
      ADD_FAILURE() << outcome.error().text();
      return "";
    }
    return outcome->input_sha256;
  }
  static const SampleLease& last(const Assembly& assembly, const std::string& channel) {
    for (const auto& c : assembly.parts.channels)
      if (c->entry->name == channel) return c->port.sample();
    ADD_FAILURE() << "no channel " << channel;
    return assembly.parts.channels.front()->port.sample();
  }
  test::TempDir dir;
};

/// The model alone, told what the script tells, at the instants at which the sink's latency has it.
SkidSteer alone() {
  const auto platform_model = load_skid_steer(kSource + "/configs/platforms/seekurjr.yaml");
  return SkidSteer(*platform_model, {.x_m = -2, .y_m = 1, .yaw_rad = 0, .seed = 5, .name = "robot"},
                   Ground());
}
void drive(SkidSteer& robot, Duration latency, Duration until) {
  robot.start(BenchTime(0));
  const auto signal = [&](const char* name) {
    std::size_t i = 0;
    while (robot.signals()[i].name != name) ++i;
    return i;
  };
  for (int k = 0; milliseconds(50) * k + latency <= until; ++k) {
    const double at_s = 0.05 * k;
    const BenchTime t = BenchTime(0) + milliseconds(50) * k + latency;
    EXPECT_TRUE(robot.write(signal("v"), at_s < 1.4999 ? 0.5 : at_s < 2.9999 ? 0.4 : 0, t));
    EXPECT_TRUE(robot.write(signal("w"), at_s < 1.4999 ? 0 : at_s < 2.9999 ? 0.5 : 0, t));
  }
}

TEST_F(Platforms, AreDrivenByASinkAtTheInstantsOfItsCommands) {
  auto assembly = make(
      platform() + "channels:\n  truth: { kind: pose, backend: simulated, platform: robot, rate_hz: 100 }\n" +
      kDrive + kScript);
  ASSERT_TRUE(assembly);
  run(*assembly);
  const SampleLease& sample = last(*assembly, "truth");
  ASSERT_TRUE(sample);
  const auto* pose = sample->as<Pose>();
  ASSERT_TRUE(pose);
  SkidSteer robot = alone();
  drive(robot, milliseconds(11), seconds(4));
  const Pose expected = robot.motion_at(sample->stamp.t_capture).body.T_world_body;
  EXPECT_GT(pose->position_m[0], -1);  // it went somewhere
  EXPECT_EQ(pose->position_m, expected.position_m);
  EXPECT_EQ(pose->orientation_wxyz, expected.orientation_wxyz);
}

const char* const kScanner =
    "  scan: { kind: point_cloud, backend: simulated, rate_hz: 12.5, latency_ms: 160, sensor: SHEET, "
    "renderer: "
    "rays, "
    "parent: robot, T_parent_sensor: { position_m: [0.5, 0, 0.8], roll_pitch_yaw_deg: [0, 0, 0] } }\n";
std::string scanner() {
  std::string text = kScanner;
  return text.replace(text.find("SHEET"), 5, kSource + "/configs/sensors/sick-tim781s.yaml");
}

TEST_F(Platforms, CarrySensorsWhoseFiringsSeeThemAtTheirOwnInstants) {
  auto assembly =
      make(platform() + "channels:\n" + scanner() + kDrive +
           "application: { name: script, sinks: { drive: { rate_hz: 20, steps: [ { at_s: 0, values: [1.0, "
           "0.3] } ] } } }\n");
  ASSERT_TRUE(assembly);
  run(*assembly);
  const SampleLease& scan = last(*assembly, "scan");
  ASSERT_TRUE(scan);
  SkidSteer robot = alone();
  robot.start(BenchTime(0));
  for (int k = 0; k < 80; ++k) {
    const BenchTime t = BenchTime(0) + milliseconds(50 * k + 11);
    EXPECT_TRUE(robot.write(16, 1.0, t));  // v
    EXPECT_TRUE(robot.write(17, 0.3, t));  // w
  }
  const auto count = scan->as<PointCloudInfo>()->count;
  std::vector<LidarPoint> points(count);
  std::memcpy(points.data(), scan->bytes().data(), count * sizeof(LidarPoint));
  double sum = 0, square = 0, sum_frozen = 0;
  int n = 0;
  for (const LidarPoint& p : points) {
    const auto world = [&](BenchTime t) {
      const Eigen::Vector3d at(p.x_m + 0.5, p.y_m, p.z_m + 0.8);
      return Eigen::Vector3d(isometry_of(robot.motion_at(t).body.T_world_body) * at);
    };
    const Eigen::Vector3d w = world(scan->stamp.t_capture + nanoseconds(p.t_offset_ns));
    if (std::abs(w.x() - 5) > 0.3 || std::abs(w.y()) > 8) continue;
    sum += w.x() - 5;
    square += (w.x() - 5) * (w.x() - 5);
    sum_frozen += std::abs(world(scan->stamp.t_capture).x() - w.x());
    ++n;
  }
  ASSERT_GT(n, 100);
  // The scanner's floor is 11.6 mm; the mean of n is known to 11.6 / sqrt(n). The wall is where it is.
  EXPECT_NEAR(sum / n, 0, 4 * 0.0125 / std::sqrt(n) + 0.001);
  EXPECT_LT(std::sqrt(square / n), 0.016);
  // Taken as one instant, the same points would be off by more than that.
  EXPECT_GT(sum_frozen / n, 0.01);
}

TEST_F(Platforms, RunsRepeatByteForByteOnOneAndOnFourWorkers) {
  const std::string rig = platform() + "channels:\n" + scanner() +
                          "  truth: { kind: pose, backend: simulated, platform: robot, rate_hz: 50 }\n" +
                          kDrive + kScript;
  std::string seen;
  for (const int workers : {1, 4, 1}) {
    auto assembly = make(rig, workers);
    ASSERT_TRUE(assembly);
    const std::string digest = run(*assembly);
    ASSERT_FALSE(digest.empty());
    if (seen.empty()) seen = digest;
    EXPECT_EQ(digest, seen) << workers << " workers";
  }
}

std::string can(const std::string& more) {
  return "backend: can, emulated_by: robot, interface: vcan0, dbc: " + kSource +
         "/configs/buses/seekurjr.dbc" + more;
}
std::string bus() {
  return "  wheels: { kind: registers, rate_hz: 50, latency_ms: 5, " +
         can(", signals: [ { message: WheelAngles, signal: left_angle }, { message: WheelAngles, signal: "
             "right_angle } ] }\n") +
         "  truth: { kind: registers, latency_ms: 1, " +
         can(", signals: [ { message: TruePose, signal: x_m }, { message: TruePose, signal: y_m }, { "
             "message: TruePose, "
             "signal: z_m }, { message: TruePose, signal: roll_deg }, { message: TruePose, signal: pitch_deg "
             "}, { "
             "message: TruePose, signal: yaw_deg } ] }\n");
}
std::string bus_drive() {
  return "sinks:\n  drive: { latency_ms: 10.5, " +
         can(", signals: [ { message: DriveCommand, signal: v }, { message: DriveCommand, signal: w } ], "
             "safe: { v: 0, w: "
             "0 } }\n") +
         "emulators:\n  robot: { backend: can, platform: robot, interface: vcan0, bitrate: 500000, "
         "data_bitrate: "
         "2000000, dbc: " +
         kSource + "/configs/buses/seekurjr.dbc, node: Robot }\n";
}

TEST_F(Platforms, OnABusGoAsInProcessToItsResolution) {
  auto assembly =
      make(platform(", channel: truth") + "channels:\n" + bus() +
           "  followed: { kind: pose, backend: simulated, platform: robot, rate_hz: 100, latency_ms: 40 }\n" +
           bus_drive() + kScript);
  ASSERT_TRUE(assembly);
  run(*assembly);
  // A command of 10.5 ms and one of 11 ms take effect at the same instant of the model's grid of 2 ms.
  SkidSteer robot = alone();
  drive(robot, milliseconds(11), seconds(4));
  const SampleLease& truth = last(*assembly, "truth");
  ASSERT_TRUE(truth);
  const auto* values = truth->as<RegisterBlock>();
  ASSERT_TRUE(values && values->count == 6);
  const Pose expected = robot.motion_at(truth->stamp.t_capture).body.T_world_body;
  EXPECT_GT(values->value[0], -1);
  for (const std::size_t i : {0u, 1u, 2u})
    EXPECT_NEAR(values->value[i], expected.position_m[i], 0.51e-4) << i;
  const double yaw_deg =
      2 * std::atan2(expected.orientation_wxyz[3], expected.orientation_wxyz[0]) * 180 / std::numbers::pi;
  EXPECT_NEAR(values->value[5], yaw_deg, 0.51e-5);
  const auto* wheels = last(*assembly, "wheels")->as<RegisterBlock>();
  EXPECT_NEAR(wheels->value[0], robot.motion_at(BenchTime(0) + seconds(4)).joint[0].position_rad, 0.51e-4);
}

TEST_F(Platforms, AreDevicesOnModbus) {
  const std::string link = "backend: modbus, emulated_by: robot, address: 127.0.0.1, port: 5027";
  auto assembly = make(platform(", channel: truth") +
                       "channels:\n  truth: { kind: registers, rate_hz: 100, latency_ms: 10, " + link +
                       ", registers: [ { name: x_m, table: input_registers, address: 14, type: s32, scale: "
                       "0.0001 }, { name: y_m, table: "
                       "input_registers, address: 16, type: s32, scale: 0.0001 }, { name: yaw_deg, table: "
                       "input_registers, address: 24, "
                       "type: s32, scale: 0.0001 } ] }\nsinks:\n  drive: { latency_ms: 11, " +
                       link +
                       ", registers: [ { name: v, table: holding_registers, address: 2, type: s32, scale: "
                       "0.001 }, { name: w, table: "
                       "holding_registers, address: 4, type: s32, scale: 0.001 } ], safe: { v: 0, w: 0 } "
                       "}\nemulators:\n  robot: { "
                       "backend: modbus, platform: robot, address: 127.0.0.1, port: 5027 }\n" +
                       kScript);
  ASSERT_TRUE(assembly);
  run(*assembly);
  SkidSteer robot = alone();
  drive(robot, milliseconds(11), seconds(4));
  const auto* values = last(*assembly, "truth")->as<RegisterBlock>();
  ASSERT_TRUE(values);
  const Pose expected = robot.motion_at(BenchTime(0) + seconds(4)).body.T_world_body;
  // It stands by then. Commands come a step of the model later at most: 2 ms of 0.5 m/s at each of three
  // changes.
  EXPECT_GT(values->value[0], -1);
  EXPECT_NEAR(values->value[0], expected.position_m[0], 3e-3);
  EXPECT_NEAR(values->value[1], expected.position_m[1], 3e-3);
}

TEST_F(Platforms, ThatABusTellsOfAreWhereTheyWereToTheResolutionOfItsReports) {
  auto assembly = make(platform(", channel: truth") + "channels:\n" + bus() + bus_drive() +
                       "application: { name: script, sinks: { drive: { rate_hz: 20, steps: [ { at_s: 0, "
                       "values: [0.5, 0.4] } ] } } }\n");
  ASSERT_TRUE(assembly);
  run(*assembly);
  SkidSteer robot = alone();
  robot.start(BenchTime(0));
  for (int k = 0; k < 80; ++k) {
    EXPECT_TRUE(robot.write(16, 0.5, BenchTime(0) + milliseconds(50 * k + 11)));
    EXPECT_TRUE(robot.write(17, 0.4, BenchTime(0) + milliseconds(50 * k + 11)));
  }
  // Between two reports of 10 ms the bench's body is where the device was, but for the time that a frame
  // takes on the bus: up to 0.7 ms (at 500 kbit/s, behind a command's frame) of 0.5 m/s and of 0.4 rad/s, and
  // for the steps of the DBC.
  for (int k = 3500; k < 3950; k += 7) {
    const BenchTime t = BenchTime(0) + milliseconds(k);
    const WorldMotion m = assembly->parts.motion.motion_at(t);
    ASSERT_EQ(m.body_count, 1u);
    const BodyState followed = m.body[0], truth = robot.motion_at(t).body;
    for (const std::size_t i : {0u, 1u, 2u}) {
      EXPECT_NEAR(followed.at(t).position_m[i], truth.T_world_body.position_m[i], 4e-4);
      EXPECT_NEAR(followed.velocity_mps[i] + (t - followed.t_ref).seconds() * followed.acceleration_mps2[i],
                  truth.velocity_mps[i], 0.02);  // two steps of 0.1 mm in 10 ms
    }
    // Stuffed bits make frames some microseconds longer or shorter: 1e-3 of the 10 ms between two.
    EXPECT_NEAR(followed.turn_rate_radps[2], truth.turn_rate_radps[2], 5e-4);
  }
}

TEST_F(Platforms, ComplaintsSayWhereAndWhatToDo) {
  const auto has = [](const std::string& text, const std::string& part) {
    EXPECT_NE(text.find(part), std::string::npos) << text << "\n  lacks: " << part;
  };
  has(error_of("  platforms: { robot: { kind: skid-ster } }\n"), "skid-steer");
  has(error_of("  platforms: { robot: { kind: skid-steer, modle: x } }\n"), "did you mean model");
  has(error_of(platform() +
               "channels:\n  truth: { kind: pose, backend: simulated, platform: robt, rate_hz: 100 }\n"),
      "expected one of `simulation.platforms` (robot), got \"robt\"");
  has(error_of(platform(", channel: nobody")),
      "expected a channel of kind pose or registers, got \"nobody\"");
  has(error_of(platform() +
               "sinks:\n  drive: { backend: simulated, platform: robot, signals: [v, omega] }\n"),
      "enable, v, w, left, right");
  has(error_of(platform() + "channels:\n" + bus() +
               "  followed: { kind: pose, backend: simulated, platform: robot, rate_hz: 10 }\n" +
               bus_drive()),
      "expected `channel` in simulation.platforms.robot");
  has(error_of(platform(", felled: wheels") + kDrive), "felled: expected none: the bench moves robot itself");
}

/// A LiDAR and a camera that look at a tree, and a harvester whose head hangs at it.
TEST_F(Platforms, ThatFellATreeChangeTheNextScanAndNotTheOneBefore) {
  Harvester machine(HarvesterConfig{}, {.x_m = -12, .y_m = 0}, Ground(), {});
  const Eigen::Vector3d head = machine.T_world_head(BenchTime(0)).translation();
  char tree[400];
  std::snprintf(tree, sizeof tree,
                "  - { id: 5, type: Tree, attributes: { position: [%.3f, %.3f, 0], species: PIAB, dbh_m: "
                "0.3, height_m: 18 } }\n",
                head.x() + 0.2, head.y() - 0.1);
  test::write_file(dir / "world.yaml", std::string(kWorld) + tree);
  char mount[200];
  std::snprintf(mount, sizeof mount,
                "T_world_sensor: { position_m: [%.3f, %.3f, 1.3], roll_pitch_yaw_deg: [0, 0, 90] }",
                head.x() + 0.2, head.y() - 0.1 - 3);
  const std::string rig =
      "  platforms:\n    harvester: { kind: harvester, T_world_start: { position_m: [-12, 0] }, visible: "
      "false }\n"
      "channels:\n  scan: { kind: point_cloud, backend: simulated, rate_hz: 12.5, latency_ms: 160, sensor: " +
      kSource + "/configs/sensors/sick-tim781s.yaml, renderer: rays, " + mount +
      " }\n"
      "sinks:\n  crane: { backend: simulated, platform: harvester, latency_ms: 10, signals: [fell] }\n"
      "application: { name: script, sinks: { crane: { rate_hz: 20, steps: [ { at_s: 0, values: [0] }, { "
      "at_s: 2, values: "
      "[1] } ] } } }\n";
  std::string seen;
  for (const int workers : {1, 4}) {
    auto assembly = make(rig, workers);
    ASSERT_TRUE(assembly);
    auto config = load_rig(dir / "rig.yaml", {});
    ASSERT_TRUE(config);
    SensorOptions ideal;
    ideal.ideal = true;
    auto lidar = assembly->simulation->sampler(SampleKind::point_cloud, config->channels[0].source.params, 1,
                                               "probe", ideal);
    ASSERT_TRUE(lidar) << lidar.error().text();
    auto pool = make_sample_pool(1, (*lidar)->geometry().max_bytes);
    SampleSlot slot = pool->try_acquire();
    const auto hits_tree = [&](double t_s) {
      SampleProvider::Request request;
      request.t_capture = BenchTime(0) + seconds_from(t_s);
      request.motion = assembly->parts.motion.motion_at(request.t_capture);
      EXPECT_TRUE((*lidar)->capture(request, *slot));
      const std::size_t count = slot->as<PointCloudInfo>()->count;
      int hits = 0;
      for (std::size_t i = 0; i < count; ++i) {
        LidarPoint p;
        std::memcpy(&p, slot->bytes().data() + i * sizeof p, sizeof p);
        hits += std::abs(p.x_m - 3) < 0.3 && std::abs(p.y_m) < 0.3;
      }
      return hits;
    };
    EXPECT_GE(hits_tree(0), 5);

    const std::string digest = run(*assembly);
    if (seen.empty()) seen = digest;
    EXPECT_EQ(digest, seen);
    const auto& harvester = *assembly->simulation->platforms()[0].model;
    ASSERT_EQ(harvester.fellings().size(), 1u);
    EXPECT_EQ(harvester.fellings()[0].node, 5u);
    EXPECT_EQ(harvester.fellings()[0].t, BenchTime(0) + milliseconds(2010));

    // Asked in any order, each instant has its own trees.
    EXPECT_GE(hits_tree(1.9), 5);
    EXPECT_EQ(hits_tree(2.05), 0);
    EXPECT_GE(hits_tree(2.0), 5);
    EXPECT_EQ(hits_tree(3.0), 0);
  }
}

/// Two scanners on the cabin look down past the tree; the machine is a Modbus device, in a world of its own.
TEST_F(Platforms, ThatSomebodyElseMovesFellTreesOfTheBenchsWorldWhenTheyTellOfIt) {
  Harvester machine(HarvesterConfig{}, {.x_m = -12, .y_m = 0}, Ground(), {});
  const Eigen::Vector3d head = machine.T_world_head(BenchTime(0)).translation();
  const Eigen::Vector3d tree(head.x() + 0.2, head.y() - 0.1, 0);
  char node[400];
  std::snprintf(node, sizeof node,
                "  - { id: 5, type: Tree, attributes: { position: [%.4f, %.4f, 0], species: PIAB, dbh_m: "
                "0.3, height_m: 18, crown_base_m: 8 } }\n",
                tree.x(), tree.y());
  test::write_file(dir / "world.yaml", std::string(kWorld) + node);
  const std::string link = "backend: modbus, emulated_by: machine, address: 127.0.0.1, port: 5028";
  const auto told = [](const char* name, int address) {
    char text[160];
    std::snprintf(text, sizeof text,
                  "{ name: %s, table: input_registers, address: %d, type: s32, scale: %s }", name, address,
                  std::string(name) == "felled" ? "1" : "0.0001");
    return std::string(text);
  };
  const auto scan = [](const char* name, const char* y, const char* yaw) {
    return std::string("  ") + name +
           ": { kind: point_cloud, backend: simulated, rate_hz: 12.5, latency_ms: 160, renderer: rays, "
           "sensor: " +
           kSource +
           "/configs/sensors/sick-tim781s.yaml, parent: harvester.cabin, T_parent_sensor: { position_m: "
           "[1, " +
           y + ", -1], roll_pitch_yaw_deg: [0, 14, " + yaw + "] } }\n";
  };
  const std::string rig =
      "  platforms:\n    harvester: { kind: harvester, T_world_start: { position_m: [-12, 0] }, visible: "
      "false, "
      "channel: truth, felled: head }\n"
      "channels:\n" +
      scan("left", "0.85", "10") + scan("right", "-0.85", "-10") +
      "  truth: { kind: registers, rate_hz: 100, latency_ms: 5, " + link + ", registers: [ " +
      told("x_m", 24) + ", " + told("y_m", 26) + ", " + told("yaw_deg", 34) + " ] }\n" +
      "  head: { kind: registers, rate_hz: 20, latency_ms: 20, " + link + ", registers: [ " +
      told("felled", 22) + ", " + told("felled_x_m", 46) + ", " + told("felled_y_m", 48) +
      ", { name: felled_yaw_deg, table: input_registers, address: 50, type: s32, scale: 0.001 } ] }\n" +
      "sinks:\n  crane: { latency_ms: 20, " + link +
      ", registers: [ { name: fell, table: holding_registers, address: 18, type: s32 } ], safe: { fell: 0 } "
      "}\n"
      "emulators:\n  machine: { backend: modbus, platform: harvester, address: 127.0.0.1, port: 5028 }\n"
      "application: { name: script, sinks: { crane: { rate_hz: 20, steps: [ { at_s: 0, values: [0] }, { "
      "at_s: 2, "
      "values: [1] } ] } } }\n";
  std::string seen;
  for (const int workers : {1, 4}) {
    auto assembly = make(rig, workers);
    ASSERT_TRUE(assembly);
    const std::string digest = run(*assembly);
    if (seen.empty()) seen = digest;
    EXPECT_EQ(digest, seen) << workers << " workers";
    auto config = load_rig(dir / "rig.yaml", {});
    ASSERT_TRUE(config);
    SensorOptions ideal;
    ideal.ideal = true;
    for (const std::size_t which : {0u, 1u}) {
      const auto& entry = config->channels[which];
      auto lidar =
          assembly->simulation->sampler(SampleKind::point_cloud, entry.source.params, 1, "probe", ideal);
      ASSERT_TRUE(lidar) << lidar.error().text();
      auto pool = make_sample_pool(1, (*lidar)->geometry().max_bytes);
      SampleSlot slot = pool->try_acquire();
      const Eigen::Isometry3d T_world_sensor =
          Eigen::Translation3d(-12 + HarvesterConfig{}.cabin_x_m + 1, which == 0 ? 0.85 : -0.85, 2.6) *
          Eigen::AngleAxisd((which == 0 ? 10 : -10) * std::numbers::pi / 180, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(14 * std::numbers::pi / 180, Eigen::Vector3d::UnitY());
      struct Seen {
        int stem = 0, behind = 0, lying = 0;
      };
      const auto look = [&](double t_s) {
        SampleProvider::Request request;
        request.t_capture = BenchTime(0) + seconds_from(t_s);
        request.motion = assembly->parts.motion.motion_at(request.t_capture);
        EXPECT_TRUE((*lidar)->capture(request, *slot));
        Seen all;
        const double away = std::atan2(tree.y() - T_world_sensor.translation().y(),
                                       tree.x() - T_world_sensor.translation().x());
        for (std::size_t i = 0; i < slot->as<PointCloudInfo>()->count; ++i) {
          LidarPoint p;
          std::memcpy(&p, slot->bytes().data() + i * sizeof p, sizeof p);
          const Eigen::Vector3d w = T_world_sensor * Eigen::Vector3d(p.x_m, p.y_m, p.z_m);
          all.stem += (w - tree).head<2>().norm() < 0.25 && w.z() > 0.4;
          const Eigen::Vector3d d = w - T_world_sensor.translation();
          all.behind += std::abs(std::atan2(d.y(), d.x()) - away) < 0.015 && w.x() > tree.x() + 0.5;
          // The trunk: 0.3 m · 0.625 thick, away from the machine, before it the stump.
          all.lying += w.x() > tree.x() + 0.4 && w.x() < tree.x() + 13 && std::abs(w.y() - tree.y()) < 0.11 &&
                       w.z() > 0.05 && w.z() < 0.2;
        }
        return all;
      };
      const Seen before = look(1.99), after = look(2.3);
      EXPECT_GE(before.stem, 5) << entry.name;
      EXPECT_EQ(before.behind, 0) << entry.name;
      EXPECT_EQ(before.lying, 0) << entry.name;
      EXPECT_EQ(after.stem, 0) << entry.name;
      EXPECT_GE(after.behind, 4) << entry.name;
      EXPECT_GE(after.lying, 2) << entry.name;
      EXPECT_EQ(look(1.99).stem, before.stem) << "the past keeps its tree";
    }
  }
}

}  // namespace
}  // namespace rigor
