// A small world of the tests' own, as files that a user would have: heights, trees, a road, a plan.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "tests/cli/command.h"

namespace rigor::test {

inline constexpr const char* kPlan =
    "half_extent_m: 190\n"
    "spacing_m: 10\n"
    "utc: 2024-06-21T11:00:00Z\n"
    "sources:\n"
    "  - elevation: dem.asc\n"
    "    crs: EPSG:32632\n"
    "  - vector: road.geojson\n"
    "    becomes: road\n"
    "    columns: { width_m: width }\n"
    "  - trees: trees.csv\n"
    "    crs: EPSG:32632\n";

inline std::string ascii_grid() {
  std::string text = "ncols 41\nnrows 41\nxllcorner 499795\nyllcorner 5199795\ncellsize 10\n";
  for (int row = 0; row < 41; ++row)
    for (int column = 0; column < 41; ++column)
      text += std::to_string(400 + (row * 7 + column * 3) % 3 * 0.1) + (column < 40 ? ' ' : '\n');
  return text;
}

/// Trees in rows across the north, 60 m and more from the origin.
inline std::string tree_list() {
  std::string text = "tree_id,species,dbh_cm,easting,northing\n";
  for (int i = 0; i < 24; ++i)
    text += std::to_string(i + 1) + (i % 2 != 0 ? ",Picea," : ",Fagus,") + std::to_string(20 + i) + "," +
            std::to_string(499940 + i % 8 * 15) + "," + std::to_string(5200060 + i / 8 * 40) + "\n";
  return text;
}

constexpr const char* kRoad =
    R"({"type":"FeatureCollection","crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::32632"}},)"
    R"("features":[{"type":"Feature","properties":{"width":5},"geometry":{"type":"LineString",)"
    R"("coordinates":[[499850,5200020],[500150,5200030]]}}]})";

class World : public ::testing::Test {
 protected:
  World() {
    write_file(dir / "dem.asc", ascii_grid());
    write_file(dir / "trees.csv", tree_list());
    write_file(dir / "road.geojson", kRoad);
    write_file(dir / "plan.import.yaml", kPlan);
  }
  /// `rigor world …` in the test's folder.
  [[nodiscard]] Said world(std::vector<std::string> words) const {
    words.insert(words.begin(), "world");
    return rigor(std::move(words), dir.path());
  }
  [[nodiscard]] Said import(const std::string& output, std::vector<std::string> more = {}) const {
    std::vector<std::string> words{"import", "plan.import.yaml", "-o", output};
    words.insert(words.end(), more.begin(), more.end());
    return world(std::move(words));
  }
  [[nodiscard]] std::string exported(const std::string& what) const {
    const Said said = world({"export", what, "-o", "exported.yaml", "--force"});
    EXPECT_EQ(said.status, 0) << said.err;
    return read_file(dir / "exported.yaml");
  }
  [[nodiscard]] std::set<std::string> files() const {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(dir.path()))
      names.insert(entry.path().filename().string());
    return names;
  }
  TempDir dir;
};

}  // namespace rigor::test
