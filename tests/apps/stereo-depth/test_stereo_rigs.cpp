// The rigs of the stereo camera as a user runs them: one view of each, and what the run tells of its time and
// its samples.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

class StereoRigs : public ::testing::Test {
 protected:
  /// One view, all in a folder of its own. `told`: what the run says of itself.
  json view(const std::string& rig, bool ideal, json* told = nullptr) {
    std::vector<std::string> words{"run",
                                   config("rigs/" + rig),
                                   "--json",
                                   "--duration",
                                   "0.99",
                                   "--record",
                                   (dir / "run.mcap").string(),
                                   "--set",
                                   "application.output=" + out()};
    if (ideal)
      for (const char* set :
           {"channels.left.ideal=true", "channels.right.ideal=true", "application.pinholes=true"})
        words.insert(words.end(), {"--set", set});
    const Said said = rigor(words);
    EXPECT_EQ(said.status, 0) << said.err;
    if (said.status != 0) return {};
    if (told) *told = json::parse(said.out);
    return json::parse(read_file(dir / "stereo/result.json"));
  }
  [[nodiscard]] std::string out() const { return (dir / "stereo").string(); }
  TempDir dir;
};

TEST_F(StereoRigs, IdealCamerasInASimpleSceneLookTooGood) {
  json told;
  const json ideal = view("stereo.yaml", true, &told), real = view("stereo-forest.yaml", false);
  ASSERT_FALSE(ideal.is_null());
  ASSERT_FALSE(real.is_null());
  const json a = ideal["evaluation"]["all"], b = real["evaluation"]["all"];
  EXPECT_EQ(ideal["pairs"], 1);
  EXPECT_GT(a["judged_px"], 250000);
  EXPECT_GT(b["judged_px"], 100000);
  EXPECT_GT(a["completeness"], 0.95);
  EXPECT_GT(a["correct"], 0.85);
  EXPECT_GT(a["completeness"], b["completeness"].get<double>() + 0.02);
  EXPECT_GT(a["correct"], b["correct"].get<double>() + 0.05);
  EXPECT_LT(a["bad2"], b["bad2"]);
  EXPECT_LT(a["disparity_rms_px"], b["disparity_rms_px"]);
  // Not so good that the truth was matched with itself, nor so bad that rows or times do not fit.
  EXPECT_GT(a["disparity_rms_px"], 0.05);
  EXPECT_GT(b["correct"], 0.2);
  EXPECT_LT(std::abs(b["disparity_bias_px"].get<double>()), 0.5);

  // Where the time went: the cameras' light by the engine, the truth's by rays; nothing is more than the
  // whole.
  ASSERT_EQ(told["times"]["sensors"].size(), 3u);
  for (const json& s : told["times"]["sensors"]) {
    EXPECT_GE(s["captures"], 1);
    EXPECT_GT(s["light_s"], 0);
    EXPECT_GE(s["wall_s"], s["light_s"]);
    EXPECT_LE(s["wall_s"].get<double>() * 1e3,
              s["captures"].get<double>() * s["longest_ms"].get<double>() * 1.001);
  }
  EXPECT_GT(told["times"]["cpu_s"], 0);
  EXPECT_GT(told["times"]["recorder_cpu_s"], 0);
  for (const char* step : {"inputs", "capture", "application", "outputs"})
    EXPECT_GT(told["times"]["loop_s"][step], 0) << step;
  for (const json& c : told["channels"]) {
    const json& n = c["accounts"];
    EXPECT_EQ(n["shown"], 1) << n;
    EXPECT_EQ(n["taken_by_loop"], n["shown"].get<int>() + n["superseded"].get<int>() +
                                      n["overflow"].get<int>() + n["before_start"].get<int>() +
                                      n["not_due_at_end"].get<int>());
    ASSERT_EQ(n["sources"].size(), 1u);
    EXPECT_EQ(n["sources"][0]["handed_on"], n["taken_by_loop"]);
  }
}

TEST_F(StereoRigs, AReplayMeasuresTheSame) {
  const json seen = view("stereo.yaml", false);
  ASSERT_FALSE(seen.is_null());
  std::filesystem::remove_all(dir / "stereo");
  const Said said = rigor({"replay", (dir / "run.mcap").string(), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json again = json::parse(read_file(dir / "stereo/result.json"));
  EXPECT_EQ(again["pairs"], 1);
  EXPECT_EQ(again["evaluation"], seen["evaluation"]);
}

TEST_F(StereoRigs, WhatDoesNotFitIsRefused) {
  const auto refused = [&](const std::string& set) {
    const Said said = rigor({"run", config("rigs/stereo.yaml"), "--duration", "0.01", "--set",
                             "application.output=" + out(), "--set", set});
    EXPECT_EQ(said.status, 2) << said.err;
    return said.err;
  };
  EXPECT_THAT(refused("application.left.channel=lefd"),
              HasSubstr("expected the name of a channel (left, right, truth)"));
  EXPECT_THAT(refused("application.right.channel=truth"), HasSubstr("kind image"));
  EXPECT_THAT(refused("application.left.model=../sensors/demo-camera.yaml"), HasSubstr("752 x 480"));
  EXPECT_THAT(refused("application.right.T_base_sensor.position_m=[0, 0.3, 1.2]"), HasSubstr("to the right"));
  EXPECT_THAT(refused("application.matcher.disparities=100"), HasSubstr("multiple of 16"));
  EXPECT_THAT(refused("channels.left.pixel_format=RGB8"), HasSubstr("Mono8"));
  EXPECT_THAT(refused("application.output=/proc/no"), HasSubstr("output"));
}

}  // namespace
}  // namespace rigor::test
