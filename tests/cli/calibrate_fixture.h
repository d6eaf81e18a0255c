// Recordings for tests of `rigor calibrate`: made once for a process by `rigor run`, of a board that turns
// before two cameras and a LiDAR, and of a wall before a time-of-flight camera.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command.h"

namespace rigor::test {

/// A folder with board.mcap (turntable, left as a pair, right, top) and wall.mcap (tof).
class CalibrationRecordings {
 public:
  static const CalibrationRecordings& get();
  [[nodiscard]] std::string board() const { return (dir_ / "board.mcap").string(); }
  [[nodiscard]] std::string wall() const { return (dir_ / "wall.mcap").string(); }

 private:
  CalibrationRecordings();
  TempDir dir_;
};

class Calibrate : public ::testing::Test {
 protected:
  /// In the test's folder, with `calibrate` before the words.
  Said run(std::vector<std::string> words) const {
    words.insert(words.begin(), "calibrate");
    return rigor(std::move(words), dir.path());
  }
  nlohmann::json answer(std::vector<std::string> words, int status = 0) const {
    words.emplace_back("--json");
    const Said said = run(std::move(words));
    EXPECT_EQ(said.status, status) << said.err << said.out.substr(0, 2000);
    auto json = nlohmann::json::parse(said.out, nullptr, false);
    EXPECT_FALSE(json.is_discarded()) << said.out;
    return json;
  }
  /// `parameters` holds these names, each with a value, and with a sigma above nothing.
  static void expect_parameters(const nlohmann::json& answer, const std::vector<std::string>& names) {
    for (const auto& name : names) {
      ASSERT_TRUE(answer["parameters"].contains(name)) << name << " in " << answer["parameters"].dump();
      EXPECT_TRUE(answer["parameters"][name]["value"].is_number()) << name;
      EXPECT_GT(answer["parameters"][name]["sigma"].get<double>(), 0) << name;
    }
    for (const char* key :
         {"residuals", "rejected", "models", "not_identifiable", "weak_directions", "warnings"})
      EXPECT_TRUE(answer.contains(key)) << key;
    EXPECT_FALSE(answer["interrupted"].get<bool>());
  }
  /// A page that needs nothing from elsewhere, and the answer beside it.
  void expect_report(const std::string& folder, const std::string& title) const {
    const std::string page = read_file(dir / folder / "index.html");
    EXPECT_NE(page.find("<title>" + title), std::string::npos) << page.substr(0, 300);
    EXPECT_NE(page.find("<svg"), std::string::npos);
    EXPECT_NE(page.find("<h2>Parameters</h2><table>"), std::string::npos);
    for (const char* elsewhere : {"src=\"http", "href=\"http", "<link", "<script src", "@import"})
      EXPECT_EQ(page.find(elsewhere), std::string::npos) << elsewhere;
    EXPECT_TRUE(nlohmann::json::accept(read_file(dir / folder / "result.json")));
  }
  /// Bad input: the status, one line that says this, and nothing that was not there before.
  void expect_refused(const std::vector<std::string>& words, const std::vector<std::string>& says) const {
    std::string line;
    for (const auto& w : words) line += w + ' ';
    SCOPED_TRACE(line);
    const auto before = files();
    const Said said = run(words);
    EXPECT_EQ(said.status, 2) << said.err;
    for (const auto& text : says) EXPECT_THAT(said.err, ::testing::HasSubstr(text));
    EXPECT_THAT(said.out, ::testing::IsEmpty());
    EXPECT_EQ(files(), before);
  }
  [[nodiscard]] std::vector<std::string> files() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(dir.path()))
      names.push_back(entry.path().string());
    std::sort(names.begin(), names.end());
    return names;
  }
  static std::string sensor(const std::string& name) { return config("sensors/" + name + ".yaml"); }
  static constexpr const char* kBoard = "chessboard:9x6:0.1";
  TempDir dir;
};

}  // namespace rigor::test
