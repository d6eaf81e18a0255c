// Worlds from the command line: what import writes is what info, export and other programs read.
#include <gmock/gmock.h>
#include <sqlite3.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/cli/world_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// The first column of the first row that SQLite itself answers.
double answer_of(const std::filesystem::path& file, const std::string& sql) {
  sqlite3* db = nullptr;
  sqlite3_stmt* statement = nullptr;
  EXPECT_EQ(sqlite3_open_v2(file.c_str(), &db, SQLITE_OPEN_READONLY, nullptr), SQLITE_OK);
  EXPECT_EQ(sqlite3_prepare_v2(db, sql.c_str(), -1, &statement, nullptr), SQLITE_OK) << sqlite3_errmsg(db);
  double answer = -1;
  if (statement != nullptr && sqlite3_step(statement) == SQLITE_ROW)
    answer = sqlite3_column_double(statement, 0);
  sqlite3_finalize(statement);
  sqlite3_close(db);
  return answer;
}

TEST_F(World, ImportSaysWhatCameOfEachSource) {
  const Said said = import("w.rigor");
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, AllOf(HasSubstr("terrain: 39 x 39 cells of 10 m"), HasSubstr("24 tree"),
                              HasSubstr("1 road"), HasSubstr("w.rigor: ")));
}

TEST_F(World, InfoCountsWhatWasImported) {
  ASSERT_EQ(import("w.rigor").status, 0);
  const Said said = world({"info", "w.rigor", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json info = json::parse(said.out);
  EXPECT_EQ(info["types"]["Tree"], 24);
  EXPECT_EQ(info["types"]["Road"], 1);
  EXPECT_EQ(info["types"]["Terrain"], 1);
  EXPECT_EQ(info["bytes"], std::filesystem::file_size(dir / "w.rigor"));
  EXPECT_NEAR(info["anchor"]["longitude_deg"].get<double>(), 9, 1e-3);
  EXPECT_NEAR(info["extent_m"]["east"].get<double>(), 190, 1e-6);
  EXPECT_EQ(info["atmosphere"]["utc_s"], 1718967600);
  EXPECT_THAT(world({"info", "w.rigor"}).out, HasSubstr("2024-06-21T11:00:00Z"));
}

TEST_F(World, InfoKnowsHowFarASceneOfBoxesReaches) {
  const Said said = world({"info", config("worlds/turntable.yaml"), "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json info = json::parse(said.out);
  EXPECT_EQ(info["types"]["Body"], 9);
  EXPECT_NEAR(info["extent_m"]["west"].get<double>(), -2.2, 1e-6);
  EXPECT_NEAR(info["extent_m"]["north"].get<double>(), 5.5, 1e-6);
}

TEST_F(World, SqliteReadsTheFile) {
  ASSERT_EQ(import("w.rigor").status, 0);
  EXPECT_EQ(answer_of(dir / "w.rigor", "SELECT count(*) FROM Tree"), 24);
  EXPECT_NEAR(answer_of(dir / "w.rigor", "SELECT max(dbh_m) FROM Tree"), 0.43, 1e-9);
  EXPECT_EQ(answer_of(dir / "w.rigor", "SELECT width_m FROM Road"), 5);
}

TEST_F(World, ExportOfTheFileIsExportOfThePlan) {
  ASSERT_EQ(import("w.rigor").status, 0);
  EXPECT_EQ(exported("w.rigor"), exported("plan.import.yaml"));
}

TEST_F(World, ExportedYamlIsTheWorldItself) {
  ASSERT_EQ(import("w.rigor").status, 0);
  ASSERT_EQ(world({"export", "w.rigor", "-o", "w.yaml"}).status, 0);
  EXPECT_EQ(exported("w.yaml"), read_file(dir / "w.yaml"));
  json a = json::parse(world({"info", "w.rigor", "--json"}).out);
  json b = json::parse(world({"info", "w.yaml", "--json"}).out);
  for (json* info : {&a, &b}) info->erase("bytes"), info->erase("world");
  EXPECT_EQ(a, b);
}

TEST_F(World, ExportsAMapOfStemsWithTheirMarks) {
  write_file(
      dir / "stand.yaml",
      "rigor_world: 1\nnext_id: 9\nnodes:\n"
      "  - { id: 1, type: Tree, attributes: { position: [1.5, -2.25, 0], dbh_m: 0.31, marked: true } }\n"
      "  - { id: 2, type: Tree, attributes: { position: [3, 4, 0], dbh_m: 0 } }\n"
      "  - { id: 3, type: Pole, attributes: { position: [7, 7, 0] } }\n"
      "  - { id: 5, type: Tree, attributes: { position: [-10, 0.125, 0], dbh_m: 0.4 } }\n");
  const Said said = world({"export", "stand.yaml", "-o", "stems.csv", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["stems"], 2);
  EXPECT_EQ(read_file(dir / "stems.csv"),
            "x_m,y_m,diameter_m,fell\n1.500,-2.250,0.31,true\n-10.000,0.125,0.4,false\n");
  EXPECT_EQ(world({"export", "stand.yaml", "-o", "stems.csv"}).status, 2) << "it is there";
  ASSERT_EQ(world({"export", "stand.yaml", "-o", "low.csv", "--at-height", "0.3"}).status, 0);
  double x = 0, y = 0, diameter = 0;
  ASSERT_EQ(std::sscanf(read_file(dir / "low.csv").c_str(), "x_m,y_m,diameter_m,fell %lf,%lf,%lf", &x, &y,
                        &diameter),
            3);
  EXPECT_NEAR(std::hypot(x - 1.5, y + 2.25), 0.02, 0.02) << "the stem is not quite straight";
  EXPECT_GT(diameter, 0.32) << "root flare";
}

TEST_F(World, ImportTwiceGivesTheSameWorld) {
  ASSERT_EQ(import("a.rigor").status, 0);
  ASSERT_EQ(import("b.rigor").status, 0);
  EXPECT_EQ(exported("a.rigor"), exported("b.rigor"));
}

TEST_F(World, ReadingAWorldTouchesNothing) {
  ASSERT_EQ(import("w.rigor").status, 0);
  const std::string bytes = read_file(dir / "w.rigor");
  auto names = files();
  ASSERT_EQ(world({"info", "w.rigor"}).status, 0);
  EXPECT_EQ(files(), names);
  (void)exported("w.rigor");
  names.insert("exported.yaml");
  EXPECT_EQ(files(), names);
  EXPECT_EQ(read_file(dir / "w.rigor"), bytes);
}

TEST_F(World, SourcesOfTheCommandLineMakeTheWorldOfThePlan) {
  ASSERT_EQ(import("plan.rigor").status, 0);
  const Said said =
      world({"import", "--elevation", "dem.asc", "--trees", "trees.csv", "--vector", "road.geojson=road",
             "--crs", "EPSG:32632", "--half-extent", "190", "--spacing", "10", "-o", "words.rigor"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(world({"info", "words.rigor", "--json"}).out)["types"],
            json::parse(world({"info", "plan.rigor", "--json"}).out)["types"]);
}

TEST_F(World, SetReplacesAValueOfThePlan) {
  ASSERT_EQ(import("w.rigor", {"--set", "half_extent_m=65", "--set", "spacing_m=5"}).status, 0);
  const json info = json::parse(world({"info", "w.rigor", "--json"}).out);
  EXPECT_NEAR(info["extent_m"]["north"].get<double>(), 65, 1e-6);
  EXPECT_LT(info["types"]["Tree"], 24);
}

TEST_F(World, TheWeatherOfTheMomentIsInTheFile) {
  write_file(dir / "weather.csv",
             "time,rain_mm_per_h\n2024-06-21T00:00:00Z,0\n2024-06-21T11:00:00Z,4\n2024-06-21T23:00:00Z,0\n");
  write_file(dir / "plan.import.yaml", std::string(kPlan) + "  - weather: weather.csv\n");
  ASSERT_EQ(import("w.rigor").status, 0);
  for (const char* what : {"w.rigor", "plan.import.yaml"})
    EXPECT_EQ(json::parse(world({"info", what, "--json"}).out)["atmosphere"]["rain_mm_per_h"], 4) << what;
  EXPECT_EQ(answer_of(dir / "w.rigor", "SELECT rain_mm_per_h FROM Atmosphere"), 4);
}

TEST_F(World, AFileThatIsThereIsKeptUnlessForced) {
  write_file(dir / "w.rigor", "precious");
  const Said refused = import("w.rigor");
  EXPECT_EQ(refused.status, 2);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("w.rigor: "), HasSubstr("--force")));
  EXPECT_EQ(read_file(dir / "w.rigor"), "precious");
  EXPECT_EQ(import("w.rigor", {"--force"}).status, 0);
  EXPECT_EQ(world({"info", "w.rigor"}).status, 0);

  write_file(dir / "w.yaml", "precious");
  EXPECT_EQ(world({"export", "w.rigor", "-o", "w.yaml"}).status, 2);
  EXPECT_EQ(read_file(dir / "w.yaml"), "precious");
  EXPECT_EQ(world({"export", "w.rigor", "-o", "w.yaml", "--force"}).status, 0);
  EXPECT_EQ(world({"info", "w.yaml"}).status, 0);
}

TEST_F(World, AnImportThatFailsLeavesNothing) {
  write_file(dir / "trees.csv", tree_list() + "25,Picea,thick,500000,5200000\n");
  const auto before = files();
  const Said said = import("w.rigor");
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("trees.csv:26: dbh_m: expected a number in column dbh_cm, got 'thick'"));
  EXPECT_EQ(files(), before);
}

TEST_F(World, AForcedImportThatFailsKeepsTheOldWorld) {
  ASSERT_EQ(import("w.rigor").status, 0);
  const std::string bytes = read_file(dir / "w.rigor");
  write_file(dir / "trees.csv", tree_list() + "25,Picea\n");
  const auto before = files();
  EXPECT_EQ(import("w.rigor", {"--force"}).status, 2);
  EXPECT_EQ(read_file(dir / "w.rigor"), bytes);
  EXPECT_EQ(files(), before);
}

TEST_F(World, AForcedExportThatFailsKeepsTheOldFile) {
  write_file(dir / "broken.rigor", "no world");
  write_file(dir / "w.yaml", "precious");
  const auto before = files();
  EXPECT_EQ(world({"export", "broken.rigor", "-o", "w.yaml", "--force"}).status, 2);
  EXPECT_EQ(read_file(dir / "w.yaml"), "precious");
  EXPECT_EQ(files(), before);
}

TEST_F(World, JsonIsValidWhereThingsGoWellAndWhereTheyDoNot) {
  const json report = json::parse(import("w.rigor", {"--json"}).out);
  EXPECT_EQ(report["world"], "w.rigor");
  EXPECT_EQ(report["lines"].size(), 3U);
  const json yaml = json::parse(world({"export", "w.rigor", "-o", "w.yaml", "--json"}).out);
  EXPECT_EQ(yaml["nodes"], report["nodes"]);
  const std::vector<std::vector<std::string>> failing = {
      {"import", "nowhere.import.yaml", "-o", "x.rigor", "--json"},
      {"import", "plan.import.yaml", "--json"},
      {"import", "plan.import.yaml", "-o", "x.rigor", "--half-extent", "far", "--json"},
      {"info", "nowhere.rigor", "--json"},
      {"export", "nowhere.rigor", "-o", "x.yaml", "--json"},
      {"render", "w.rigor", "-o", "x.bmp", "--json"},
      {"render", "w.rigor", "-o", "x.png", "--set", "Tree.hight_m=3", "--json"}};
  for (const auto& words : failing) {
    const Said said = world(words);
    EXPECT_EQ(said.status, 2) << said.err;
    ASSERT_TRUE(json::accept(said.out)) << words[0] << ": " << said.out;
    const json failure = json::parse(said.out);
    EXPECT_EQ(failure["exit_status"], 2);
    EXPECT_THAT(said.err, HasSubstr(failure["error"].get<std::string>()));
  }
}

TEST_F(World, JsonIsValidForNamesThatAreNotUtf8) {
  ASSERT_EQ(import("w\xff.rigor").status, 0);
  for (const char* what : {"w\xff.rigor", "nowhere\xff.rigor"}) {
    const Said said = world({"info", what, "--json"});
    EXPECT_TRUE(json::accept(said.out)) << said.out << said.err;
    EXPECT_THAT(said.err, ::testing::Not(HasSubstr("defect")));
  }
}

/// What follows "Example: " in the help of a command, as words.
std::vector<std::string> example_of(const std::string& command) {
  const std::string help = rigor({"world", command, "--help"}).out;
  const auto at = help.find("Example: rigor ");
  EXPECT_NE(at, std::string::npos) << help;
  std::vector<std::string> words;
  std::istringstream line(help.substr(at == std::string::npos ? help.size() : at + 15));
  for (std::string word; line >> word;) words.push_back(word);
  return words;
}

TEST_F(World, TheExamplesOfTheHelpWork) {
  std::filesystem::create_directory_symlink(std::filesystem::path(config("worlds")).parent_path(),
                                            dir / "configs");
  for (const char* command : {"import", "info", "export", "render"}) {
    auto words = example_of(command);
    ASSERT_GE(words.size(), 3U);
    EXPECT_EQ(words[1], command);
    if (words[1] == "render") words.insert(words.end(), {"--width", "160", "--height", "120"});
    const Said said = rigor(words, dir.path());
    EXPECT_EQ(said.status, 0) << command << ": " << said.err;
  }
}

}  // namespace
}  // namespace rigor::test
