// What a user gets from `rigor world …` for input that is wrong: a message with its place, exit status 2, and
// no file.
#include <gmock/gmock.h>
#include <sqlite3.h>

#include "tests/cli/world_fixture.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

struct Wrong {
  std::vector<std::string> words;  ///< of `rigor world`
  std::string message;             ///< a part of what it says
};

class WorldBadInput : public World {
 protected:
  void expect_refused(const std::vector<Wrong>& cases) const {
    const auto before = files();
    for (const auto& wrong : cases) {
      std::string line;
      for (const auto& word : wrong.words) line += word + ' ';
      SCOPED_TRACE(line);
      const Said said = world(wrong.words);
      EXPECT_EQ(said.status, 2);
      EXPECT_THAT(said.err, HasSubstr(wrong.message));
      EXPECT_EQ(files(), before);
    }
  }
  void expect_plan_refused(const std::string& plan, const std::string& message) const {
    write_file(dir / "plan.import.yaml", plan);
    expect_refused({{{"import", "plan.import.yaml", "-o", "x.rigor"}, message}});
  }
};

TEST_F(WorldBadInput, Commands) {
  expect_refused({{{}, "subcommand"},
                  {{"fly"}, "expected one of the commands import, info, export, render, got \"fly\""},
                  {{"import", "-o", "x.rigor"}, "expected a plan (*.import.yaml) or sources"},
                  {{"import", "plan.import.yaml"}, "--output is required"},
                  {{"info"}, "WORLD is required"}});
}

TEST_F(WorldBadInput, FilesThatAreNotThere) {
  expect_refused(
      {{{"import", "nowhere.import.yaml", "-o", "x.rigor"}, "nowhere.import.yaml: "},
       {{"info", "nowhere.rigor"}, "nowhere.rigor: expected a world"},
       {{"export", "nowhere.rigor", "-o", "x.yaml"}, "nowhere.rigor: expected a world"},
       {{"render", "nowhere.rigor", "-o", "x.png"}, "nowhere.rigor: expected a world"},
       {{"import", "--elevation", "nowhere.asc", "-o", "x.rigor"}, "nowhere.asc: expected"},
       {{"import", "--trees", "nowhere.csv", "-o", "x.rigor"}, "nowhere.csv: expected"},
       {{"import", "--vector", "nowhere.geojson=road", "-o", "x.rigor"}, "nowhere.geojson: expected"}});
}

TEST_F(WorldBadInput, OutputsWithAWrongEndingOrWithoutAFolder) {
  expect_refused(
      {{{"import", "plan.import.yaml", "-o", "x.yaml"}, "-o: expected a file that ends in .rigor"},
       {{"import", "plan.import.yaml", "-o", "dem.asc/x.rigor"},
        "dem.asc/x.rigor: expected a name in a folder"},
       {{"import", "plan.import.yaml", "-o", "."}, "-o: expected a file that ends in .rigor"},
       {{"export", "plan.import.yaml", "-o", "x.rigor"}, "-o: expected a file that ends in .yaml"},
       {{"export", "plan.import.yaml", "-o", "x.import.yaml"}, "-o: expected a file that ends in .yaml"},
       {{"export", "plan.import.yaml", "-o", "dem.asc/x.yaml"}, "dem.asc/x.yaml: expected a name in"},
       {{"render", "plan.import.yaml", "-o", "x.jpg"}, "-o: expected a file that ends in .png or .exr"},
       {{"render", "plan.import.yaml", "-o", "dem.asc/x.png"}, "dem.asc/x.png: expected a name in"}});
}

TEST_F(WorldBadInput, UnknownKeyOfAPlanHasLineColumnAndTheNearestName) {
  expect_plan_refused("half_extend_m: 190\nsources: [ { elevation: dem.asc } ]\n",
                      "plan.import.yaml:1:1: half_extend_m: unknown key; did you mean half_extent_m?");
  std::string plan = kPlan;
  plan.replace(plan.find("becomes: road"), 13, "becoms: road ");
  expect_plan_refused(plan, "plan.import.yaml:8:5: sources.1.becoms: unknown key; did you mean becomes?");
}

TEST_F(WorldBadInput, PlanWithoutSources) {
  expect_plan_refused("sources: []\n", "sources: expected at least one source");
  expect_plan_refused("spacing_m: 5\n", "sources: expected a list");
  expect_plan_refused("sources:\n  - { elevation: dem.asc, trees: trees.csv }\n",
                      "expected one of elevation");
}

TEST_F(WorldBadInput, ReferenceSystems) {
  expect_refused(
      {{{"import", "--elevation", "dem.asc", "-o", "x.rigor"},
        "dem.asc: expected a reference system, the raster has none: give it as crs"},
       {{"import", "--elevation", "dem.asc", "--crs", "EPSG:99999", "-o", "x.rigor"},
        "expected a reference system such as EPSG:25832, got 'EPSG:99999'"},
       {{"import", "--trees", "trees.csv", "-o", "x.rigor"}, "expected to be told what x and y mean"},
       {{"import", "plan.import.yaml", "--crs", "EPSG:32632", "-o", "x.rigor"},
        "--crs: expected it in the plan"}});
  // GeoJSON without `crs` is WGS84 by its standard; CSV points say nothing.
  write_file(dir / "poles.csv", "X,Y\n500000,5200000\n");
  expect_refused({{{"import", "--vector", "poles.csv=pole", "-o", "x.rigor"}, "poles.csv: "}});
}

TEST_F(WorldBadInput, WhatAVectorBecomes) {
  expect_refused(
      {{{"import", "--vector", "road.geojson", "-o", "x.rigor"}, "becomes: expected building, road"},
       {{"import", "--vector", "road.geojson=rode", "-o", "x.rigor"}, "got 'rode'"},
       {{"import", "--vector", "road.geojson:lanes=road", "-o", "x.rigor"},
        "expected one of the layers road, got 'lanes'"}});
}

TEST_F(WorldBadInput, AnchorsAndLengths) {
  const auto with = [](std::vector<std::string> more) {
    std::vector<std::string> words{"import", "plan.import.yaml", "-o", "x.rigor"};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  expect_refused(
      {{with({"--anchor", "47"}), "expected latitude,longitude[,height] in degrees and metres, got '47'"},
       {with({"--anchor", "here"}), "anchor: expected latitude,longitude"},
       {with({"--anchor", "97,9"}), "expected a latitude from -90 to 90 degrees, got 97"},
       {with({"--anchor", "47,9,1,2"}), "anchor: expected latitude,longitude"},
       {with({"--anchor", "-47,9"}), "dem.asc: expected elevation within the extent"},
       {with({"--half-extent", "0"}), "--half-extent: expected a number above 0 and up to 1e+06, got 0"},
       {with({"--spacing", "-1"}), "--spacing: expected a number from 0 to 100000, got -1"},
       {with({"--set", "half_extent_m"}), "--set half_extent_m: expected path.to.key=value"},
       {with({"--set", "cache_dirs=3"}), "did you mean cache_dir?"},
       {with({"--set", "sources.9.crs=local"}), "sources: expected the index of one of its 3 items"},
       {with({"--set", "utc=noon"}), "utc: expected a time such as 2024-06-21T10:00:00Z"}});
}

TEST_F(WorldBadInput, TimesOfAPicture) {
  std::vector<Wrong> cases;
  for (const char* time : {"noon", "2024-06-21", "2024-02-31T12:00:00Z", "2024-06-21T25:00:00Z"})
    cases.push_back(
        {{"render", "plan.import.yaml", "-o", "x.png", "--time", time},
         "--time: expected a time such as 2024-06-21T10:00:00Z, got '" + std::string(time) + "'"});
  cases.push_back({{"render", "plan.import.yaml", "-o", "x.png", "--time", "2024-06-21T10:00:00"},
                   "--time: expected a time with Z or an offset from UTC"});
  cases.push_back(
      {{"render", config("worlds/turntable.yaml"), "-o", "x.png", "--time", "2024-06-21T10:00:00Z"},
       "--time: expected a world with an Atmosphere"});
  expect_refused(cases);
}

TEST_F(WorldBadInput, AttributesToSet) {
  const auto set = [](const char* what) {
    return std::vector<std::string>{"render", "plan.import.yaml", "-o", "x.png", "--set", what};
  };
  expect_refused({{set("fog"), "--set: expected Type.attribute=value"},
                  {set("Atmospere.fog_visibility_m=50"), "did you mean Atmosphere?"},
                  {set("Atmosphere.fog_visibilty_m=50"), "did you mean fog_visibility_m?"},
                  {set("Atmosphere.fog_visibility_m=dense"), "expected a number, got \"dense\""},
                  {set("Atmosphere.fog_visibility_m=-3"), "fog_visibility_m: expected 1 to inf m, got -3"},
                  {set("Atmosphere.fixed_sun=1"), "expected true or false, got \"1\""},
                  {set("Tree.position=0"), "expected an attribute that is a flag, a number or text"},
                  {set("Body.shape=box"), "expected a node of this type in the world, found none"}});
}

TEST_F(WorldBadInput, CamerasThatCannotBe) {
  const auto with = [](std::vector<std::string> more) {
    std::vector<std::string> words{"render", "plan.import.yaml", "-o", "x.png"};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  expect_refused(
      {{with({"--eye", "5000,0,2", "--above-ground"}), "--eye: expected a place on the terrain"},
       {with({"--eye", "0,0,2", "--target", "0,5000,2", "--above-ground"}),
        "--target: expected a place on the terrain"},
       {with({"--eye", "1,2"}), "--eye"},
       {with({"--eye", "nan,0,2"}), "--eye: expected a number from -1e+08 to 1e+08, got nan"},
       {with({"--eye", "1,2,3", "--target", "1,2,3"}), "--target: expected a point that is not the eye"},
       {with({"--fov", "0"}), "--fov: expected 1 to 150 degrees"},
       {with({"--width", "0"}), "--width"},
       {with({"--white", "0"}), "--white: expected a radiance above 0"},
       {with({"--bands", "red"}), "--bands"},
       {with({"--off", "shadow"}), "--off: expected frustum-culling"}});
}

TEST_F(WorldBadInput, TreeListsInAnotherEncoding) {
  write_file(dir / "latin.csv",
             "species,dbh_cm,lat,lon\nPic\xe9"
             "a,30,46.95,9.0\n");
  expect_refused(
      {{{"import", "--trees", "latin.csv", "-o", "x.rigor"}, "latin.csv: expected CSV text in UTF-8"}});
}

TEST_F(WorldBadInput, WhatIsNoWorld) {
  write_file(dir / "text.rigor", "this is no world");
  write_file(dir / "empty.rigor", "");
  write_file(dir / "rig.yaml", "channels: {}\n");
  write_file(dir / "newer.yaml", "rigor_world: 99\n");
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open((dir / "other.rigor").c_str(), &db), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(db, "CREATE TABLE songs(title)", nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(db);
  expect_refused({{{"info", "text.rigor"}, "text.rigor: expected a Rigor world (an SQLite file)"},
                  {{"info", "empty.rigor"}, "empty.rigor: expected a Rigor world, got an empty file"},
                  {{"info", "other.rigor"}, "got an SQLite file of another program"},
                  {{"info", "rig.yaml"}, "rig.yaml:1:1: rigor_world: expected"},
                  {{"info", "newer.yaml"}, "newer.yaml:1:14: rigor_world: expected 1"},
                  {{"export", "text.rigor", "-o", "x.yaml"}, "text.rigor: expected a Rigor world"},
                  {{"render", "text.rigor", "-o", "x.png"}, "text.rigor: expected a Rigor world"}});
}

TEST_F(WorldBadInput, AWorldThatIsCutShort) {
  ASSERT_EQ(import("w.rigor").status, 0);
  const std::string bytes = read_file(dir / "w.rigor");
  for (const std::size_t kept : {std::size_t{100}, bytes.size() / 2, bytes.size() - 4096, bytes.size() - 1}) {
    SCOPED_TRACE(kept);
    write_file(dir / "cut.rigor", bytes.substr(0, kept));
    expect_refused({{{"info", "cut.rigor"}, "cut.rigor: the world is damaged or cut short"}});
  }
}

TEST_F(WorldBadInput, AWorldOfANewerRigor) {
  ASSERT_EQ(import("w.rigor").status, 0);
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open((dir / "w.rigor").c_str(), &db), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(db, "PRAGMA user_version = 99", nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(db);
  expect_refused({{{"info", "w.rigor"}, "got version 99, written by a newer Rigor"}});
}

}  // namespace
}  // namespace rigor::test
