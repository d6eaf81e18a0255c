// The tutorial's example as a user has it: Rigor installed into a prefix, the detector built there by its own
// CMake, and run as a program in Python, a program in C++ and a shared object.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class InstalledApplication : public ::testing::Test {
 protected:
  Said run(std::vector<std::string> words) const {
    Said said = Command(std::move(words), dir.path()).wait();
    EXPECT_EQ(said.status, 0) << said.out << said.err;
    return said;
  }
  TempDir dir;
};

TEST_F(InstalledApplication, IsBuiltAndRunWithoutThisTree) {
  const std::string prefix = (dir / "prefix").string(), build = (dir / "build").string();
  (void)run({"cmake", "--install", RIGOR_BINARY_DIR, "--prefix", prefix});
  EXPECT_TRUE(fs::exists(prefix + "/include/rigor_client.h"));
  const fs::path example = dir / "detector";
  fs::copy(RIGOR_SOURCE_DIR "/examples/application", example);
  const Said made =
      run({"cmake", "-S", example.string(), "-B", build, "-DCMAKE_PREFIX_PATH=" + prefix,
           "-DCMAKE_CXX_COMPILER=" RIGOR_CXX_COMPILER, "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Wpedantic -Werror"});
  (void)run({"cmake", "--build", build});
  std::string seen;
  for (const std::string& application :
       {"command: [python3, " + (example / "detector.py").string() + "]", "command: [" + build + "/detector]",
        "library: " + build + "/libdetector.so"}) {
    const Said said = run({prefix + "/bin/rigor", "run", "demo", "--clock", "virtual", "--duration", "0.4",
                           "--json", "--record", "run.mcap", "--force", "--set", "report=", "--set",
                           "application={" + application + "}"});
    if (said.status != 0) continue;
    const auto result = nlohmann::json::parse(said.out);
    EXPECT_EQ(result["sinks"][0]["applied"], 20) << application;
    if (seen.empty()) seen = result["seen_sha256"];
    EXPECT_EQ(result["seen_sha256"], seen) << application;
  }
}

}  // namespace
}  // namespace rigor::test
