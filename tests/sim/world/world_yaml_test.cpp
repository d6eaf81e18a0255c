#include "sim/world/world_yaml.h"

#include <gtest/gtest.h>

#include <filesystem>
#include "sensor-hal/config/yaml.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/world_file.h"
#include "tests/paths.h"

namespace rigor::world {
namespace {

TEST(WorldYaml, LoadsEveryWorldThatIsShipped) {
  int loaded = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(rigor::test::source_dir() + "/configs/worlds")) {
    const std::string name = entry.path().filename().string();
    if (!name.ends_with(".yaml") || name.ends_with(".import.yaml")) continue;  // plans: tests/sim/gis
    const auto document = ConfigDocument::load(entry.path());
    ASSERT_TRUE(document) << document.error().text();
    if (document->has("rigor_world")) {
      auto db = Database::create();
      ASSERT_TRUE(define_semantic_types(*db));
      const auto s = import_world_yaml(entry.path(), *db);
      EXPECT_TRUE(s) << s.error().text();
      EXPECT_GT(db->snapshot().node_count(), 0u);
      continue;
    }
    const auto scene = load_world(entry.path());
    EXPECT_TRUE(scene) << scene.error().text();
    ++loaded;
  }
  EXPECT_GE(loaded, 1);
}

TEST(WorldYaml, TheTurntableCarriesAChessboard) {
  const auto scene = load_world(rigor::test::source_dir() + "/configs/worlds/turntable.yaml");
  ASSERT_TRUE(scene) << scene.error().text();
  const auto board = find_body(*scene, "chessboard");
  const auto table = find_node(*scene, "turntable");
  ASSERT_TRUE(board && table);
  EXPECT_EQ(scene->bodies[*board].node, table);
  ASSERT_TRUE(scene->bodies[*board].chessboard);
  EXPECT_EQ(scene->bodies[*board].chessboard->columns, 9);
  EXPECT_TRUE(scene->nodes[*table].hinge);
}

TEST(WorldYaml, SaysWhereAndWhatWasExpected) {
  const std::string materials =
      "materials:\n  - { name: grey, reflectance: { red: 0.5, green: 0.5, blue: 0.5, nir: 0.5 } }\n";
  struct Case {
    std::string text, place, said;
  };
  for (const Case& c :
       {Case{materials + "bodies:\n  - { name: a, size_m: [1, 1, 1], material: gray }\n",
             "w.yaml:4:", "did you mean 'grey'"},
        Case{materials + "bodies:\n  - { name: a, size_m: [1, 1], material: grey }\n", "w.yaml:4:", "size_m"},
        Case{materials + "bodies:\n  - { name: a, size_m: [1, 0, 1], material: grey }\n",
             "w.yaml:4:", "above 0"},
        Case{materials + "bodies:\n  - { name: a, size_m: [1, 1, 1], material: grey, colour: red }\n",
             "w.yaml:4:", "unknown key"},
        Case{materials + "nodes:\n  - { name: n, parent: m }\n", "w.yaml:4:", "expected the name of a node"},
        Case{materials + "nodes:\n  - { name: n }\n  - { name: n }\n", "w.yaml:5:", "second time"},
        Case{materials + "sun: { direction_to_sun: [0, 0, 0] }\n", "w.yaml:3:", "expected a direction"},
        Case{"materials:\n  - { name: grey, reflectance: { red: 1.5, green: 0, blue: 0, nir: 0 } }\n",
             "w.yaml:2:", "red"},
        Case{materials + "ground: { material: grey, half_extent_m: -3 }\n", "w.yaml:3:", "half_extent_m"}}) {
    const auto scene = parse_world(c.text, "w.yaml");
    ASSERT_FALSE(scene) << c.text;
    const std::string said = scene.error().text();
    EXPECT_EQ(said.find(c.place), 0u) << said;
    EXPECT_NE(said.find(c.said), std::string::npos) << said;
    EXPECT_EQ(scene.error().exit_status(), 2);
  }
  EXPECT_EQ(load_world("/nowhere/w.yaml").error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace rigor::world
