// The robot of seekurjr-forest in its stand, without cameras: the whole loop over a CAN bus and back.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using testing::HasSubstr;

Said patiently(std::vector<std::string> words) {
  return Command(rigor_words(std::move(words))).wait(std::chrono::seconds(270));
}

/// The way of the rig from this row on, and where it begins there.
struct Rest {
  std::string way;
  double x_m = 0, y_m = 0, yaw_deg = 0;
};
Rest rest_of_way(std::size_t row) {
  std::istringstream in(read_file(config("worlds/data/forest-way.csv")));
  Rest rest{"x_m,y_m\n"};
  std::string line;
  std::getline(in, line);
  for (std::size_t i = 0; std::getline(in, line); ++i) {
    if (i < row) continue;
    rest.way += line + "\n";
    double x = 0, y = 0;
    EXPECT_EQ(std::sscanf(line.c_str(), "%lf,%lf", &x, &y), 2) << line;
    if (i == row) rest.x_m = x, rest.y_m = y;
    if (i == row + 4) rest.yaw_deg = std::atan2(y - rest.y_m, x - rest.x_m) * 180 / std::numbers::pi;
  }
  return rest;
}

// From 64 m on the stand is thin, and most of what looks like a stem is none: two or three of a dozen are in
// the map.
TEST(Forest, TheRobotKnowsWhereItIsWhereFewStemsAreInSightAndAReplayTellsTheSame) {
  const TempDir dir;
  const std::string recording = (dir / "run.mcap").string(), again = (dir / "again.mcap").string();
  const Rest rest = rest_of_way(126);
  const std::string way = (dir / "way.csv").string();
  write_file(way, rest.way);
  const std::string place =
      fmt::format("position_m: [{:.3f}, {:.3f}], yaw_deg: {:.2f}", rest.x_m, rest.y_m, rest.yaw_deg);
  const std::vector<std::string> changes{
      "--set", "application.path.file=" + way,
      "--set", "simulation.platforms.robot.T_world_start={" + place + "}",
      "--set", "application.start={" + place + ", sigma_m: 0.3, sigma_deg: 5}",
      "--set", "application.drive.speed_mps=0.8"};
  std::vector<std::string> words{"run",
                                 config("rigs/seekurjr-forest-light.yaml"),
                                 "--clock",
                                 "virtual",
                                 "--duration",
                                 "40",
                                 "--json",
                                 "--record",
                                 recording,
                                 "--report",
                                 (dir / "report").string()};
  words.insert(words.end(), changes.begin(), changes.end());
  const Said said = patiently(words);
  ASSERT_EQ(said.status, 0) << said.err;
  const json run = json::parse(said.out);
  const json& error = run["analyses"]["localization"];
  EXPECT_GT(error["way_m"], 28.0);
  EXPECT_EQ(error["searching"], 0);
  EXPECT_LT(error["median_m"], 0.04);
  EXPECT_LT(error["p95_m"], 0.07);
  EXPECT_LT(error["p95_yaw_deg"], 0.5);
  EXPECT_THAT(read_file(dir / "report/index.html"), HasSubstr("Where the application thought it was"));

  const Said replay =
      patiently({"replay", recording, "--json", "--record", again, "--report", (dir / "replayed").string()});
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_EQ(json::parse(replay.out)["input_sha256"], run["input_sha256"]);
  const Said a = rigor({"localization", recording}), b = rigor({"localization", again});
  EXPECT_EQ(a.status, 0) << a.err;
  EXPECT_EQ(a.out, b.out);
  EXPECT_THAT(a.out, HasSubstr("estimates over "));

  const Said other = rigor({"localization", recording, "--truth", "wheels"});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err, HasSubstr("expected true poses of a channel \"wheels\""));
  EXPECT_THAT(other.err, HasSubstr("scanner"));
  const Said sink = rigor({"localization", recording, "--estimate", "drive"});
  EXPECT_EQ(sink.status, 2);
  EXPECT_THAT(sink.err, HasSubstr("that receives x and y"));
}

/// The rig with its application in a process: `name` becomes a command, its keys become `params`.
std::string hosted(const std::string& rig) {
  const std::string begin = "\napplication:\n  name: forest-localization\n", end = "\nanalyses:";
  const auto from = rig.find(begin), to = rig.find(end);
  EXPECT_TRUE(from != std::string::npos && to != std::string::npos);
  std::string keys;
  std::istringstream lines(rig.substr(from + begin.size(), to - from - begin.size()));
  for (std::string line; std::getline(lines, line);) keys += "  " + line + "\n";
  return rig.substr(0, from) + "\napplication:\n  command: [" + rigor_words({}).front() +
         ", host, forest-localization]\n  params:\n" + keys + rig.substr(to);
}

TEST(Forest, TheSameApplicationInAProcessAndFromAPluginSeesCommandsAndRecordsTheSame) {
  const TempDir dir;
  std::filesystem::copy(config(""), dir / "configs", std::filesystem::copy_options::recursive);
  const std::string rig = (dir / "configs/rigs/forest-discs.yaml").string(),
                    in_a_process = (dir / "configs/rigs/hosted.yaml").string();
  write_file(in_a_process, hosted(read_file(rig)));
  const std::vector<std::string> forms[] = {
      {rig},
      {in_a_process},
      {rig, "--set", "plugins=[" RIGOR_FOREST_PLUGIN "]", "--set", "application.name=forest-of-a-plugin"},
      {in_a_process, "--set",
       "application.command=[" + rigor_words({}).front() +
           ", host, forest-of-a-plugin, --plugin, " RIGOR_FOREST_PLUGIN "]"}};
  json results[4];
  std::vector<std::string> recorded[4];
  for (std::size_t i = 0; i < std::size(forms); ++i) {
    std::vector<std::string> words{"run"};
    words.insert(words.end(), forms[i].begin(), forms[i].end());
    for (const char* word :
         {"--clock", "virtual", "--duration", "4", "--json", "--force", "--set", "report=", "--record"})
      words.emplace_back(word);
    words.push_back((dir / "run.mcap").string());
    const Said said = patiently(words);
    ASSERT_EQ(said.status, 0) << said.err;
    results[i] = json::parse(said.out);
    recorded[i] = all_messages((dir / "run.mcap").string());
    ASSERT_GT(recorded[i].size(), 1000U);
    if (forms[i].front() == in_a_process) {
      EXPECT_EQ(results[i]["application"]["answered"], 800);
    }
    EXPECT_EQ(results[i]["input_sha256"], results[0]["input_sha256"]) << i;
    EXPECT_EQ(results[i]["analyses"], results[0]["analyses"]) << i;
    EXPECT_TRUE(recorded[i] == recorded[0]) << i;
  }
  EXPECT_GT(results[0]["analyses"]["localization"]["way_m"], 0.5);
}

}  // namespace
}  // namespace rigor::test
