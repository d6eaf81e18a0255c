// FMUs in whole runs: the rig of examples/fmu, plants that fail, an FMU that moves a simulated camera's
// world, `rigor inspect`.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "sensor-hal/record/ros2_messages.h"
#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"
#include "tests/paths.h"
#include "tests/sim/fmu/made_fmu.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

class PlantRuns : public ::testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  /// The FMU of examples/fmu, as its CMakeLists.txt makes it.
  std::string arm() {
    const fs::path sources = fs::path(source_dir()) / "examples/fmu";
    compile({"-shared", "-fPIC", "-O2", (sources / "arm.c").string(), "-o", file("arm.so")});
    write_zip(dir / "arm.fmu", {{"modelDescription.xml", text_of(sources / "modelDescription.xml")},
                                {"binaries/" + platform(3) + "/arm.so", text_of(dir / "arm.so")}});
    return file("arm.fmu");
  }
  std::vector<std::string> example(const std::string& recording) {
    const std::string fmu = arm();
    return {"run",      source_dir() + "/examples/fmu/rig.yaml",
            "--set",    "plants.arm.fmu=" + fmu,
            "--set",    "plants.table.fmu=" + fmu,
            "--record", recording,
            "--json",   "--force"};
  }
  /// Values of a register channel by its name, of all samples.
  static std::vector<double> values(const std::string& recording, const std::string& channel,
                                    const std::string& name) {
    std::vector<double> all;
    for (const auto& block :
         messages_on<record::msg::RegisterBlock>(recording, "/" + channel + "/registers")) {
      const auto at = std::ranges::find(block.names, name) - block.names.begin();
      if (static_cast<std::size_t>(at) < block.values.size())
        all.push_back(block.values[static_cast<std::size_t>(at)]);
    }
    return all;
  }
  TempDir dir;
  Folder fmus;
};

TEST_F(PlantRuns, TheExampleGivesTheSameBytesAgainAndReplays) {
  auto words = example(file("a.mcap"));
  const Said first = rigor(words);
  ASSERT_EQ(first.status, 0) << first.err << first.out;
  const Said second = rigor(example(file("b.mcap")));
  ASSERT_EQ(second.status, 0) << second.err;
  EXPECT_EQ(all_messages(file("a.mcap")), all_messages(file("b.mcap")));
  EXPECT_GT(all_messages(file("a.mcap")).size(), 1000u);
  // In this process the same.
  words = example(file("c.mcap"));
  for (const char* plant : {"arm", "table"}) {
    words.emplace_back("--set");
    words.push_back(std::string("plants.") + plant + ".sandbox=false");
  }
  ASSERT_EQ(rigor(words).status, 0);
  EXPECT_EQ(values(file("a.mcap"), "arm", "angle"), values(file("c.mcap"), "arm", "angle"));
  const Said replayed = rigor({"replay", file("a.mcap")});
  EXPECT_EQ(replayed.status, 0) << replayed.err;

  const std::vector<double> angle = values(file("a.mcap"), "arm", "angle");
  ASSERT_EQ(angle.size(), 400u);
  EXPECT_EQ(angle[40], 0);
  EXPECT_NEAR(angle[190], 30, 0.5);  // 1.4 s after the command
  EXPECT_NEAR(angle[399], -30, 0.5);
  // Through Modbus, and from there the joint of the bench's world.
  const std::vector<double> table = values(file("a.mcap"), "table", "angle"),
                            world = values(file("a.mcap"), "world", "turntable");
  ASSERT_GT(table.size(), 390u);
  EXPECT_NEAR(table[240], 90, 1);
  ASSERT_GT(world.size(), 195u);
  EXPECT_NEAR(world[124], 90, 2);
}

/// Signals of a DBC by their names, and a pose from values that are called so.
TEST_F(PlantRuns, AnFmuIsANodeOfABusAndTellsAPose) {
  write_file(dir / "arm.dbc",
             "VERSION \"\"\nNS_ :\nBS_:\nBU_: Bench Arm\n"
             "BO_ 256 ArmState: 8 Arm\n SG_ angle : 0|32@1- (0.001,0) [-360|360] \"deg\" Bench\n"
             " SG_ rate : 32|32@1- (0.001,0) [-1000|1000] \"deg/s\" Bench\n"
             "BO_ 257 ArmCommand: 4 Bench\n SG_ target : 0|32@1- (0.001,0) [-360|360] \"deg\" Arm\n"
             "BA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 65535;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n"
             "BA_ \"GenMsgCycleTime\" BO_ 256 10;\n");
  const std::string fmu = arm();
  write_file(
      dir / "rig.yaml",
      "name: bus\nduration_s: 2\nclock: virtual\nloop: { rate_hz: 1000 }\nplants:\n"
      "  arm: { fmu: " +
          fmu +
          ", signals: { angle: { unit: deg }, rate: { unit: deg/s }, target: { unit: deg } } }\n"
          "  cart: { fmu: " +
          fmu +
          ", start_values: { target: 2 }, signals: { x_m: angle, y_m: rate } }\n"
          "channels:\n"
          "  arm: { kind: registers, backend: can, rate_hz: 100, interface: vcan0, dbc: arm.dbc,\n"
          "         signals: [ { message: ArmState, signal: angle } ] }\n"
          "  place: { kind: pose, backend: fmu, plant: cart, rate_hz: 100 }\n"
          "sinks:\n"
          "  arm_command: { backend: can, emulated_by: arm, interface: vcan0, dbc: arm.dbc,\n"
          "                 signals: [ { message: ArmCommand, signal: target } ], safe: { target: 0 } }\n"
          "emulators:\n  arm: { backend: can, plant: arm, interface: vcan0, dbc: arm.dbc, node: Arm }\n"
          "application: { name: script, sinks: { arm_command: { rate_hz: 20, steps: [ { at_s: 0.2, values: "
          "[45] } ] } } }\n");
  const Said said = rigor({"run", file("rig.yaml"), "--record", file("a.mcap")});
  ASSERT_EQ(said.status, 0) << said.err;
  const std::vector<double> angle = values(file("a.mcap"), "arm", "angle");
  ASSERT_GT(angle.size(), 190u);
  EXPECT_NEAR(angle.back(), 45, 0.5);
  const auto poses = messages_on<record::msg::PoseStamped>(file("a.mcap"), "/place/pose");
  ASSERT_GT(poses.size(), 190u);
  EXPECT_NEAR(poses.back().pose.position.x, 2, 0.02);
}

TEST_F(PlantRuns, AnFmuThatFailsMakesItsChannelDisconnectedAndTheRunGoesOn) {
  write_file(
      dir / "rig.yaml",
      "name: failing\nduration_s: 1\nclock: virtual\nloop: { rate_hz: 100 }\nplants:\n  p:\n    fmu: " +
          make_faulty_fmu(fmus).string() +
          "\n    start_values: { mode: 4, at: 0.5 }\n    signals: { y: y }\nchannels:\n"
          "  p: { kind: registers, backend: fmu, plant: p, rate_hz: 100 }\n");
  const Said said = rigor({"run", file("rig.yaml"), "--json", "--record", file("a.mcap")});
  ASSERT_EQ(said.status, 0) << said.err;
  const json report = json::parse(said.out);
  EXPECT_THAT(said.out,
              HasSubstr("plant p: fmi3DoStep returned fmi3Error at t = 0.49 s: the valve is stuck"));
  EXPECT_EQ(values(file("a.mcap"), "p", "y").size(), 50u);
  const json& channel = report["channels"][0];
  EXPECT_EQ(channel["health"]["lost"], 50);
  EXPECT_EQ(channel["health"]["protocol_errors"], 1);
  EXPECT_EQ(channel["status"].back()["status"], "disconnected");
  EXPECT_EQ(channel["disconnected_cycles"], 50);
  const auto events = messages_on<record::msg::Event>(file("a.mcap"), "/rigor/events");
  ASSERT_EQ(events.size(), 1u);
  EXPECT_THAT(events[0].text, HasSubstr("the valve is stuck"));
}

/// In a wall-clock run, an FMU that hangs for seconds does not delay the loop.
TEST_F(PlantRuns, AnFmuThatHangsDoesNotHoldTheLoopUp) {
  write_file(dir / "rig.yaml",
             "name: hanging\nduration_s: 2\nclock: wall\nloop: { rate_hz: 200, fifo_priority: 0, "
             "lock_memory: false }\nplants:\n  p:\n    fmu: " +
                 make_faulty_fmu(fmus).string() +
                 "\n    answer_timeout_s: 60\n    on_fault: restart\n    start_values: { mode: 1, at: 0.5 }\n"
                 "    signals: { y: y, u: u }\nchannels:\n"
                 "  p: { kind: registers, backend: fmu, plant: p, rate_hz: 100 }\n"
                 "sinks:\n  p_command: { backend: fmu, plant: p, signals: [u], safe: { u: 0 } }\n");
  const Said said = rigor({"run", file("rig.yaml"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json report = json::parse(said.out);
  // Half a second before it hangs has 100 cycles; a busy machine may skip some of the 300 after it.
  EXPECT_GT(report["loop"]["cycles_run"].get<int>(), 130);
  EXPECT_EQ(report["channels"][0]["status"].back()["status"], "disconnected");
}

TEST_F(PlantRuns, SayWhatARigHasWrong) {
  const std::string fmu = make_faulty_fmu(fmus).string();
  const auto refusal = [&](const std::string& plant, const std::string& channel,
                           const std::string& more = "") {
    write_file(dir / "rig.yaml", "duration_s: 1\nclock: virtual\nplants:\n  p: { fmu: " + plant +
                                     " }\nchannels:\n  c: { kind: registers, backend: fmu, rate_hz: 100, " +
                                     channel + " }\n" + more);
    const Said said = rigor({"run", file("rig.yaml")});
    EXPECT_EQ(said.status, 2) << said.err;
    return said.err;
  };
  EXPECT_THAT(refusal(fmu, "plant: q"),
              HasSubstr("channels.c.plant: expected one of the rig's `plants` (p), got \"q\""));
  EXPECT_THAT(refusal(fmu, "plant: p, signals: [yy]"),
              HasSubstr("expected a signal of the plant p (u, y, count"));
  EXPECT_THAT(refusal(file("none.fmu"), "plant: p"),
              HasSubstr("rig.yaml:4:13: plants.p.fmu: " + file("none.fmu") + ": expected an FMU"));
  EXPECT_THAT(refusal(fmu + ", signals: { y: { variable: y, unit: kg } }", "plant: p"),
              HasSubstr("measure different quantities"));
  EXPECT_THAT(refusal(fmu, "plant: p", "emulators:\n  e: { backend: modbus, plant: p, port: 5033 }\n"),
              HasSubstr("expected a plant that no emulator shows, got p"));
}

TEST_F(PlantRuns, InspectShowsVariablesUnitsAndCapabilities) {
  const std::string fmu = make_faulty_fmu(fmus).string();
  const Said text = rigor({"inspect", fmu});
  ASSERT_EQ(text.status, 0) << text.err;
  for (const char* part : {"FMU of faulty, FMI 3.0: co-simulation", "variable step, event mode", "step 10 ms",
                           "axis.speed = u, axis.place = y", "y         Float64      output"})
    EXPECT_THAT(text.out, HasSubstr(part));
  const Said as_json = rigor({"inspect", fmu, "--json"});
  ASSERT_EQ(as_json.status, 0);
  const json j = json::parse(as_json.out);
  EXPECT_EQ(j["variables"].size(), 11u);
  EXPECT_EQ(j["variables"][1]["unit"], "m/s");
  EXPECT_EQ(j["terminals"][0]["members"]["place"], "y");
  EXPECT_EQ(j["co_simulation"]["event_mode"], true);
  write_file(dir / "no.fmu", "no zip");
  const Said refused = rigor({"inspect", file("no.fmu")});
  EXPECT_EQ(refused.status, 2);
  EXPECT_THAT(refused.err, HasSubstr("expected an FMU (a zip file)"));
}

}  // namespace
}  // namespace rigor::test
