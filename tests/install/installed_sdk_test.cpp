// The examples as a user has them: Rigor installed into a prefix, each example built there by its own CMake,
// without this tree and with the strictest warnings, and run: an application as a program in Python, a
// program in C++, a shared object and embedded; a driver and its conformance.
#include <gmock/gmock.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::HasSubstr;

class InstalledSdk : public ::testing::Test {
 protected:
  void SetUp() override {
    prefix = (dir / "prefix").string();
    (void)run({"cmake", "--install", rigor::test::build_dir(), "--prefix", prefix});
  }
  Said run(std::vector<std::string> words) const {
    Said said = Command(std::move(words), dir.path()).wait();
    EXPECT_EQ(said.status, 0) << said.out << said.err;
    return said;
  }
  /// The folder of an example that came with the installation; what it builds is in `build` below it.
  std::string build(const std::string& example, const std::string& target = "all") const {
    const fs::path folder = dir / example;
    fs::copy(prefix + "/share/rigor/examples/" + example, folder);
    (void)run({"cmake", "-S", folder.string(), "-B", (folder / "build").string(),
               "-DCMAKE_PREFIX_PATH=" + prefix, "-DCMAKE_BUILD_TYPE=Release",
               "-DCMAKE_CXX_COMPILER=" RIGOR_CXX_COMPILER,
               "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Wpedantic -Werror"});
    (void)run({"cmake", "--build", (folder / "build").string(), "--target", target});
    return folder.string();
  }
  json run_demo(const std::string& application) const {
    const Said said = run({prefix + "/bin/rigor", "run", "demo", "--clock", "virtual", "--duration", "0.4",
                           "--json", "--record", "run.mcap", "--force", "--set", "report=", "--set",
                           "application={" + application + "}"});
    return said.status == 0 ? json::parse(said.out) : json();
  }
  TempDir dir;
  std::string prefix;
};

TEST_F(InstalledSdk, HasTheApplicationThatSeesTheSameInEveryForm) {
  EXPECT_TRUE(fs::exists(prefix + "/include/rigor_client.h"));
  const std::string example = build("application");
  std::string seen;
  std::vector<std::string> recorded;
  for (const std::string& application :
       {"command: [python3, " + example + "/detector.py]", "command: [" + example + "/build/detector]",
        "library: " + example + "/build/libdetector.so"}) {
    const json result = run_demo(application);
    ASSERT_TRUE(result.is_object()) << application;
    EXPECT_EQ(result["sinks"][0]["applied"], 20) << application;
    if (seen.empty()) seen = result["input_sha256"];
    EXPECT_EQ(result["input_sha256"], seen) << application;
    const auto messages = all_messages(dir / "run.mcap");
    if (recorded.empty()) recorded = messages;
    EXPECT_GT(messages.size(), 100U);
    EXPECT_TRUE(messages == recorded) << application;
  }
  const std::string embedded = build("embedded");
  const Said said =
      run({"env", "RIGOR_CONFIGS=" + prefix + "/share/rigor/configs", embedded + "/build/embedded_test"});
  EXPECT_THAT(said.out, HasSubstr("digest " + seen));
  EXPECT_TRUE(all_messages(dir / "embedded.mcap") == recorded) << "byte for byte, as the other forms";
}

TEST_F(InstalledSdk, HasTheDriverThatPassesTheConformanceSuiteAndRunsInARig) {
  const std::string example = build("driver");
  const Said conformance = run({example + "/build/conformance_test"});
  EXPECT_THAT(conformance.out, HasSubstr("[  PASSED  ]"));
  EXPECT_THAT(conformance.out, ::testing::Not(HasSubstr("SKIPPED"))) << conformance.out;
  for (const char* clock : {"virtual", "wall"}) {
    const Said said = run({prefix + "/bin/rigor", "run", example + "/rig.yaml", "--clock", clock, "--json"});
    if (said.status != 0) continue;
    const json result = json::parse(said.out);
    EXPECT_GE(result["channels"][0]["delivered"], 90) << clock;
    EXPECT_EQ(result["expect"][0]["holds"], true) << clock;
  }
  const Said doctor =
      run({prefix + "/bin/rigor", "doctor", "--plugin", example + "/build/libtext_sensor.so"});
  EXPECT_THAT(doctor.out, HasSubstr("text-sensor: needs a UDP port"));
}

TEST_F(InstalledSdk, HasTheFmuThatARigRunsInAProcessOfItsOwn) {
  const std::string example = build("fmu");
  const Said said =
      run({prefix + "/bin/rigor", "run", example + "/rig.yaml", "--json", "--record", "fmu.mcap", "--set",
           "simulation.world=" + prefix + "/share/rigor/configs/worlds/turntable.yaml"});
  if (said.status == 0) {
    EXPECT_EQ(json::parse(said.out)["channels"][0]["delivered"], 400);
  }
}

TEST_F(InstalledSdk, RefusesAPluginThatWasBuiltAgainstAnotherHal) {
  // One header differs, as in another version.
  std::ofstream(prefix + "/include/rigor/rigor/hal_abi.h")
      << "#pragma once\n#define RIGOR_HAL_HEADERS_DIGEST \"0\"\n";
  const std::string example = build("driver", "text_sensor");
  const Said said =
      Command({prefix + "/bin/rigor", "run", example + "/rig.yaml", "--clock", "virtual"}, dir.path()).wait();
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("rig.yaml:5:"));
  EXPECT_THAT(said.err, HasSubstr("got headers 0; build the plugin again"));
}

/// A program of somebody else that has this tree within its own.
class Subdirectory : public ::testing::TestWithParam<std::tuple<const char*, const char*, const char*>> {};

TEST_P(Subdirectory, GivesItsTargetsAndNoFlagOfItsOwn) {
  const auto& [core_only, target, header] = GetParam();
  const TempDir dir;
  write_file(
      dir / "CMakeLists.txt",
      std::string("cmake_minimum_required(VERSION 3.25)\nproject(mine "
                  "CXX)\nset(CMAKE_EXPORT_COMPILE_COMMANDS ON)\n") +
          "set(RIGOR_CORE_ONLY " + core_only + ")\nadd_subdirectory(" + rigor::test::source_dir() +
          " rigor EXCLUDE_FROM_ALL)\nadd_library(mine MODULE mine.cpp)\ntarget_link_libraries(mine PRIVATE " +
          target + ")\n");
  write_file(dir / "mine.cpp", std::string("#include <") + header + ">\n");
  const Said said = Command({"cmake", "-S", dir.path().string(), "-B", (dir / "build").string(),
                             "-DCMAKE_CXX_COMPILER=" RIGOR_CXX_COMPILER},
                            dir.path())
                        .wait();
  ASSERT_EQ(said.status, 0) << said.out << said.err;
  std::ifstream in(dir / "build/compile_commands.json");
  std::string command;
  for (const json& c : json::parse(in))
    if (c["file"].get<std::string>().ends_with("/mine.cpp")) command = c["command"];
  EXPECT_THAT(command, HasSubstr("-I" + rigor::test::source_dir()));
  for (const char* flag : {"-Wconversion", "-Wshadow", "-ffp-contract", "ggc-min"})
    EXPECT_THAT(command, ::testing::Not(HasSubstr(flag)));
  EXPECT_FALSE(fs::exists(dir / "build/rigor/tests")) << "its tests are its own";
  const Said compiled = Command({"sh", "-c", command + " -fsyntax-only"}, dir / "build").wait();
  EXPECT_EQ(compiled.status, 0) << compiled.err;
}

INSTANTIATE_TEST_SUITE_P(OfTheCoreAndOfAll, Subdirectory,
                         ::testing::Values(std::tuple{"ON", "Rigor::Hal", "sensor-hal/channel/registry.h"},
                                           std::tuple{"OFF", "Rigor::Bench", "bench/bench.h"}));

}  // namespace
}  // namespace rigor::test
