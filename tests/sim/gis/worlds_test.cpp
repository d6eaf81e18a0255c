// The worlds that come with Rigor.
#include <cstdlib>
#include <fstream>

#include "sim/world/store/world_file.h"
#include "tests/paths.h"
#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

namespace fs = std::filesystem;
const std::string kWorlds = rigor::test::source_dir() + "/configs/worlds/";

std::string bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Imported imported(const std::string& name, const std::vector<std::string>& sets = {}) {
  std::vector<ConfigOverride> overrides;
  for (const auto& s : sets) overrides.push_back(*ConfigOverride::parse(s));
  const auto plan = load_import_plan(kWorlds + name, overrides);
  if (!plan) {
    Imported failed;
    failed.db = fresh_world();
    failed.report = tl::unexpected(plan.error());
    return failed;
  }
  return import(*plan);
}

TEST(Worlds, InputsAreWhatTheScriptMakes) {
  const Folder f;
  const std::string command =
      "python3 " + rigor::test::source_dir() + "/tools/make_world_inputs.py " + (f / "data");
  ASSERT_EQ(std::system(command.c_str()), 0);
  std::size_t files = 0;
  for (const auto& e : fs::directory_iterator(f.path() / "data")) {
    ++files;
    EXPECT_EQ(bytes_of(e.path()), bytes_of(kWorlds + "data/" + e.path().filename().string()))
        << e.path().filename();
  }
  EXPECT_GE(files, 10u);
}

TEST(Worlds, ForestIsAHectareOfTrees) {
  const Imported w = imported("forest.import.yaml");
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_EQ(w.warnings(), "");
  EXPECT_EQ(w.nodes("Tree").size(), 520u);
  EXPECT_EQ(w.nodes("GroundVegetation").size(), 2u);
  for (const float z : terrain_of(w.world()).z) ASSERT_FALSE(std::isnan(z));
  EXPECT_EQ(world::world_yaml(w.world()), world::world_yaml(imported("forest.import.yaml").world()));
}

TEST(Worlds, HillsHaveAllThatStandsInALandscape) {
  const Imported w = imported("hills.import.yaml");
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_EQ(w.warnings(), "");
  const std::pair<const char*, std::size_t> wanted[] = {
      {"Road", 3},    {"Building", 6},  {"Fence", 3},        {"Water", 1},
      {"Terrain", 1}, {"LandCover", 1}, {"WeatherSeries", 1}};
  for (const auto& [type, n] : wanted) EXPECT_EQ(w.nodes(type).size(), n) << type;
  EXPECT_GT(w.nodes("Pole").size(), 15u);
  EXPECT_GT(w.nodes("Tree").size(), 800u);
  for (const float z : terrain_of(w.world()).z) ASSERT_FALSE(std::isnan(z));
}

TEST(Worlds, TheTestbedIsARoomOfBodies) {
  auto db = fresh_world();
  const auto read = world::import_world_yaml(kWorlds + "testbed.yaml", *db);
  ASSERT_TRUE(read) << read.error().text();
  const auto w = db->snapshot();
  const world::types::Body body(w.schema());
  EXPECT_GT(w.count(body.type), 10u);
  w.for_each(body.type, [&](world::NodeId n) {
    EXPECT_TRUE(w.target(n, body.made_of)) << w.get_or_default(n, body.name);
  });
  const auto board = w.find_named(body.type, "chessboard");
  ASSERT_TRUE(board);
  const world::Vector3 looks = w.T_world_node(*board, BenchTime{}).linear() * world::Vector3(0, 0, 1);
  EXPECT_LT((looks - world::Vector3(0, -1, 0)).norm(), 1e-12) << "towards the middle of the room";
}

TEST(Worlds, ARealStandStandsOnRealTerrain) {
  const std::string dem = shared_data("dem_srtm/srtmgl3_n40_w105.asc"),
                    trees = shared_data("forest_stands/trees.csv");
  if (dem.empty() || trees.empty()) GTEST_SKIP() << "no test data: dem_srtm or forest_stands";
  const Imported w =
      imported("real-stand.import.yaml", {"sources.0.elevation=" + dem, "sources.1.trees=" + trees});
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_EQ(w.nodes("Tree").size(), 872u);
  EXPECT_GT(w.report->anchor.height_m, 2000);
}

}  // namespace
}  // namespace rigor::gis::test
