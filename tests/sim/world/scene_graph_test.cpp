// The bench's scene as a view of the database: what goes in comes out, and what changes in the database
// shows.
#include "sim/world/scene_graph.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "sim/world/semantic_types.h"
#include "sim/world/world_yaml.h"
#include "tests/paths.h"

namespace rigor::world {
namespace {

std::unique_ptr<Database> semantic_database() {
  auto db = Database::create();
  const auto s = define_semantic_types(*db);
  EXPECT_TRUE(s) << s.error().text();
  return db;
}

void expect_same(const Scene& a, const Scene& b) {
  ASSERT_EQ(a.materials.size(), b.materials.size());
  for (std::size_t i = 0; i < a.materials.size(); ++i) {
    EXPECT_EQ(a.materials[i].name, b.materials[i].name);
    EXPECT_EQ(a.materials[i].reflectance, b.materials[i].reflectance);
    EXPECT_EQ(a.materials[i].roughness, b.materials[i].roughness);
  }
  ASSERT_EQ(a.nodes.size(), b.nodes.size());
  for (std::size_t i = 0; i < a.nodes.size(); ++i) {
    EXPECT_EQ(a.nodes[i].name, b.nodes[i].name);
    EXPECT_EQ(a.nodes[i].parent, b.nodes[i].parent);
    EXPECT_EQ(a.nodes[i].T_parent_node.matrix(), b.nodes[i].T_parent_node.matrix());
    ASSERT_EQ(a.nodes[i].hinge.has_value(), b.nodes[i].hinge.has_value());
    if (a.nodes[i].hinge) {
      EXPECT_EQ(a.nodes[i].hinge->axis, b.nodes[i].hinge->axis);
    }
  }
  ASSERT_EQ(a.bodies.size(), b.bodies.size());
  for (std::size_t i = 0; i < a.bodies.size(); ++i) {
    const Body &x = a.bodies[i], &y = b.bodies[i];
    EXPECT_EQ(x.name, y.name);
    EXPECT_EQ(x.node, y.node);
    EXPECT_EQ(x.T_node_body.matrix(), y.T_node_body.matrix());
    EXPECT_EQ(x.shape, y.shape);
    EXPECT_EQ(x.size_m, y.size_m);
    EXPECT_EQ(x.material, y.material);
    ASSERT_EQ(x.chessboard.has_value(), y.chessboard.has_value());
    if (!x.chessboard) continue;
    EXPECT_EQ(x.chessboard->columns, y.chessboard->columns);
    EXPECT_EQ(x.chessboard->rows, y.chessboard->rows);
    EXPECT_EQ(x.chessboard->square_m, y.chessboard->square_m);
    EXPECT_EQ(x.chessboard->dark_material, y.chessboard->dark_material);
  }
  ASSERT_EQ(a.ground.has_value(), b.ground.has_value());
  if (a.ground) {
    EXPECT_EQ(a.ground->T_world_ground.matrix(), b.ground->T_world_ground.matrix());
    EXPECT_EQ(a.ground->half_extent_m, b.ground->half_extent_m);
    EXPECT_EQ(a.ground->material, b.ground->material);
    EXPECT_EQ(a.ground->other_material, b.ground->other_material);
    EXPECT_EQ(a.ground->cell_m, b.ground->cell_m);
    EXPECT_EQ(a.ground->noise_contrast, b.ground->noise_contrast);
  }
  EXPECT_EQ(a.sun.direction_to_sun, b.sun.direction_to_sun);
  EXPECT_EQ(a.sun.irradiance_w_per_m2, b.sun.irradiance_w_per_m2);
  EXPECT_EQ(a.sky.zenith_radiance_w_per_m2_sr, b.sky.zenith_radiance_w_per_m2_sr);
  EXPECT_EQ(a.sky.horizon_radiance_w_per_m2_sr, b.sky.horizon_radiance_w_per_m2_sr);
}

Scene turntable() {
  auto scene = load_world(rigor::test::source_dir() + "/configs/worlds/turntable.yaml");
  EXPECT_TRUE(scene) << scene.error().text();
  return *scene;
}

TEST(SceneGraph, GivesBackWhatWasPutInBitForBit) {
  const Scene scene = turntable();
  auto db = semantic_database();
  ASSERT_TRUE(put_scene(*db, scene));
  const auto again = scene_of(db->snapshot());
  ASSERT_TRUE(again) << again.error().text();
  expect_same(scene, *again);
}

TEST(SceneGraph, OfAnEmptyWorldIsEmpty) {
  auto db = semantic_database();
  const auto scene = scene_of(db->snapshot());
  ASSERT_TRUE(scene) << scene.error().text();
  EXPECT_TRUE(scene->bodies.empty());
  EXPECT_FALSE(scene->ground);
}

TEST(SceneGraph, ShowsWhatTheDatabaseSaysNow) {
  auto db = semantic_database();
  ASSERT_TRUE(put_scene(*db, turntable()));
  const types::Body body(db->schema());
  const auto box = db->snapshot().find_named(body.type, "red-box");
  ASSERT_TRUE(box);
  auto tx = db->begin("grow");
  ASSERT_TRUE(tx.set(*box, body.size_m, Vector3(1, 2, 3)));
  ASSERT_TRUE(tx.commit());
  auto scene = scene_of(db->snapshot());
  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->bodies[*find_body(*scene, "red-box")].size_m, Vector3(1, 2, 3));
  ASSERT_TRUE(db->undo());
  scene = scene_of(db->snapshot());
  ASSERT_TRUE(scene);
  expect_same(*scene, turntable());
}

TEST(SceneGraph, SaysWhichBodyHasNoMaterial) {
  auto db = semantic_database();
  const types::Body body(db->schema());
  auto tx = db->begin();
  const auto id = tx.create(body.type);
  ASSERT_TRUE(id);
  ASSERT_TRUE(tx.set(*id, body.name, std::string("bare")));
  ASSERT_TRUE(tx.commit());
  const auto scene = scene_of(db->snapshot());
  ASSERT_FALSE(scene);
  EXPECT_EQ(scene.error().code, ErrorCode::bad_input);
  EXPECT_THAT(scene.error().text(), testing::HasSubstr("'bare'"));
}

}  // namespace
}  // namespace rigor::world
