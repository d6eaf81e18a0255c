// The reference application on devices behind protocols and on mixed channels:
// configs/rigs/forest-discs-*.yaml, seekurjr-forest-*.yaml.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "sensor-hal/rig/rig.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;

std::string rig(const std::string& mode) { return config("rigs/forest-discs" + mode + ".yaml"); }

/// A port of loopback that nobody uses now.
std::string free_port() {
  const int s = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof a;
  EXPECT_EQ(bind(s, reinterpret_cast<sockaddr*>(&a), size), 0);
  EXPECT_EQ(getsockname(s, reinterpret_cast<sockaddr*>(&a), &size), 0);
  close(s);
  return std::to_string(ntohs(a.sin_port));
}

class Modes : public ::testing::Test {
 protected:
  json run(const std::string& mode, const std::string& recording, std::vector<std::string> more) {
    std::vector<std::string> words{
        "run", rig(mode), "--json", "--record", (dir / recording).string(), "--report", (dir / "r").string()};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(words);
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out) : json();
  }
  /// Stems are found to centimetres and the map is good to 20 mm: lost, or in another frame, it would be off
  /// by decimetres and more.
  static void expect_at_home(const json& result, double way_m, double median_m, double worst_m) {
    ASSERT_TRUE(result["analyses"].contains("localization")) << result.dump().substr(0, 400);
    const json& e = result["analyses"]["localization"];
    EXPECT_GT(e["way_m"].get<double>(), way_m);
    EXPECT_LT(e["median_m"].get<double>(), median_m) << e["text"];
    EXPECT_LT(e["worst_m"].get<double>(), worst_m) << e["text"];
  }
  void expect_replayed(const std::string& recording, const std::string& mode, const json& result) {
    const Said said = rigor({"replay", (dir / recording).string(), rig(mode), "--json", "--report", ""});
    ASSERT_EQ(said.status, 0) << said.err;
    EXPECT_EQ(json::parse(said.out)["input_sha256"], result["input_sha256"]);
  }
  TempDir dir;
};

TEST_F(Modes, TheApplicationIsTheSameToItsLastKey) {
  const std::vector<std::pair<std::string, std::vector<std::string>>> families{
      {"forest-discs", {"forest-discs-emulated", "forest-discs-can", "forest-discs-mixed"}},
      {"seekurjr-forest-light", {"seekurjr-forest", "seekurjr-forest-emulated", "seekurjr-forest-mixed"}}};
  for (const auto& [name, others] : families) {
    const auto first = load_rig(config("rigs/" + name + ".yaml"), {});
    ASSERT_TRUE(first) << first.error().text();
    for (const std::string& mode : others) {
      const auto other = load_rig(config("rigs/" + mode + ".yaml"), {});
      ASSERT_TRUE(other) << other.error().text();
      EXPECT_EQ(other->application_params.dump(), first->application_params.dump()) << mode;
      ASSERT_EQ(other->sinks.size(), first->sinks.size());
      for (const ChannelEntry& c : first->channels) {
        if (c.name == "truth") continue;  // the application has no use of it: registers of a bus, or poses
        EXPECT_EQ(std::count_if(other->channels.begin(), other->channels.end(),
                                [&](const ChannelEntry& o) { return o.name == c.name && o.kind == c.kind; }),
                  1)
            << c.name << " of " << mode;
      }
    }
  }
}

TEST_F(Modes, OnCanModbusAndSickInVirtualTimeItKnowsWhereItIsAndTheRunRepeats) {
  for (const std::string mode : {"-can", "-mixed"}) {
    std::vector<std::string> words{"--clock", "virtual", "--duration", "8"};
    if (mode == "-mixed") {
      words.emplace_back("--set");
      words.emplace_back("channels.scanner.pair.switches=[{at_s: 4, active: simulated}]");
    }
    const json first = run(mode, "first.mcap", words);
    expect_at_home(first, 3.5, 0.02, 0.06);
    words.insert(words.end(), {"--workers", "1"});
    run(mode, "second.mcap", words);
    EXPECT_TRUE(read_file(dir / "first.mcap") == read_file(dir / "second.mcap")) << mode;
    expect_replayed("first.mcap", mode, first);
  }
}

TEST_F(Modes, DriveDevicesOnLoopbackByTheWallClock) {
  const std::string robot = free_port(), sensors = free_port(), scanner = free_port();
  std::vector<std::string> words{"--duration", "6", "--no-control"};
  for (const std::string path : {"channels.truth", "sinks.drive", "emulators.robot"})
    words.insert(words.end(), {"--set", path + ".port=" + robot});
  for (const std::string path : {"channels.odometry", "channels.imu", "channels.gnss", "emulators.sensors"})
    words.insert(words.end(), {"--set", path + ".port=" + sensors});
  for (const std::string path : {"channels.scanner", "emulators.scanner"})
    words.insert(words.end(), {"--set", path + ".port=" + scanner});
  const json result = run("-emulated", "wall.mcap", words);
  // A machine that is busy delays answers, and with them what the stamps of Modbus are worth.
  expect_at_home(result, 0.5, 0.2, 1);
  for (const json& c : result["channels"]) EXPECT_GT(c["fresh"].get<int>(), 0) << c["name"];
  expect_replayed("wall.mcap", "-emulated", result);
}

}  // namespace
}  // namespace rigor::test
