#include <gtest/gtest.h>

#include <cmath>

#include "sim/render/content/world_view.h"
#include "sim/render/models/body_mesh.h"
#include "sim/render/models/providers.h"
#include "sim/world/scene.h"
#include "sim/world/semantic_types.h"
#include "tests/sim/nature/built/mesh_checks.h"

namespace rigor::render {
namespace {

using Eigen::Vector3d;

SurfacePtr grey(const char* name, float reflectance, float roughness = 1) {
  auto s = std::make_shared<Surface>();
  s->name = name;
  s->reflectance.fill(reflectance);
  s->roughness = roughness;
  return s;
}

TEST(BodyMesh, BoxAndCylinderAreClosed) {
  const auto box = box_mesh({1, 2, 3}, grey("a", 0.5F));
  EXPECT_EQ(test::open_edge_count(*box), 0);
  EXPECT_NEAR(test::volume_m3(*box), 6, 1e-5);
  EXPECT_GT(test::worst_normal(*box), 0.999);
  const auto cylinder = cylinder_mesh({2, 2, 3}, grey("a", 0.5F));
  EXPECT_EQ(test::open_edge_count(*cylinder), 0);
  EXPECT_NEAR(test::volume_m3(*cylinder), M_PI * 3, 0.01 * M_PI * 3);
  EXPECT_GT(test::worst_normal(*cylinder), 0.99);
}

TEST(BodyMesh, ChessboardHasItsCornersWhereTheSceneSaysThem) {
  const auto light = grey("light", 0.8F), dark = grey("dark", 0.05F);
  const auto mesh =
      chessboard_mesh({1.4, 1.0, 0.02}, light, {.columns = 9, .rows = 6, .square_m = 0.1, .dark = dark});
  EXPECT_EQ(test::open_edge_count(*mesh), 0);
  EXPECT_NEAR(test::volume_m3(*mesh), 1.4 * 1.0 * 0.02, 1e-6);
  const auto is = [](const char* name) {
    return [=](const Vector3d& n, const Surface& s) { return s.name == name && n.z() > 0.9; };
  };
  EXPECT_NEAR(test::area_m2(*mesh, is("dark")), 35 * 0.01, 1e-6);
  EXPECT_NEAR(test::area_m2(*mesh, is("light")), 1.4 - 35 * 0.01, 1e-6);
  world::Body body;
  body.size_m = {1.4, 1.0, 0.02};
  body.chessboard = world::Chessboard{};
  // Where the scene has an inner corner, two dark and two light squares meet.
  const auto colour_at = [&](const Vector3d& p) {
    std::string found;
    test::each_triangle(*mesh, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const Surface& s) {
      const Vector3d q[] = {test::position(*mesh, a), test::position(*mesh, b), test::position(*mesh, c)};
      for (const auto& v : q)
        if (v.z() < 0.0099) return;
      for (int k = 0; k < 3; ++k)
        if ((q[(k + 1) % 3] - q[k]).cross(p - q[k]).z() < 0) return;
      found = s.name;
    });
    return found;
  };
  for (const Vector3d& corner : world::chessboard_corners_in_body(body)) {
    const auto at = [&](double x, double y) { return colour_at(corner + Vector3d(x, y, 0)); };
    EXPECT_NE(at(0.05, 0.05), at(-0.05, 0.05));
    EXPECT_NE(at(0.05, 0.05), at(0.05, -0.05));
    EXPECT_EQ(at(0.05, 0.05), at(-0.05, -0.05));
  }
  EXPECT_EQ(colour_at({-0.45, -0.30, 0.01}), "light") << "the square at the least x and y";
  EXPECT_EQ(colour_at({-0.35, -0.30, 0.01}), "dark");
}

TEST(BodyMesh, ABoardLargerThanItsFaceIsCutOff) {
  const auto mesh = chessboard_mesh({0.5, 0.5, 0.02}, grey("light", 0.8F),
                                    {.columns = 9, .rows = 6, .square_m = 0.1, .dark = grey("dark", 0.05F)});
  EXPECT_NEAR(test::area_m2(*mesh, [](const Vector3d& n, const Surface&) { return n.z() > 0.9; }), 0.25,
              1e-6);
  EXPECT_NEAR(mesh->bounds.max().x(), 0.25, 1e-6);
}

float linear(std::uint8_t byte) {
  const float v = static_cast<float>(byte) / 255;
  return v <= 0.04045F ? v / 12.92F : std::pow((v + 0.055F) / 1.055F, 2.4F);
}

TEST(GroundPlane, CellsHaveTheReflectanceOfTheirMaterials) {
  const auto ground =
      ground_surface({.cell_m = 0.5, .even = grey("a", 0.6F, 1.0F), .odd = grey("b", 0.2F, 0.5F)});
  EXPECT_NEAR(ground.repeat_m, 1.0, 1e-12);
  const Surface& s = *ground.surface;
  ASSERT_TRUE(s.colour_map && s.near_infrared_map && s.gloss_map);
  const auto at = [&](const Texture& t, double x, double y) {  // metres from the ground's origin
    const double u = x / ground.repeat_m, v = -y / ground.repeat_m;
    const auto column = static_cast<std::size_t>((u - std::floor(u)) * t.width),
               row = static_cast<std::size_t>((v - std::floor(v)) * t.height);
    return t.rgba[4 * (row * t.width + column)];
  };
  EXPECT_NEAR(s.reflectance[0] * linear(at(*s.colour_map, 0.25, 0.25)), 0.6, 0.003);
  EXPECT_NEAR(s.reflectance[0] * linear(at(*s.colour_map, 0.75, 0.25)), 0.2, 0.003);
  EXPECT_NEAR(s.reflectance[0] * linear(at(*s.colour_map, -0.25, 0.25)), 0.2, 0.003);
  EXPECT_NEAR(s.reflectance[5] * linear(at(*s.near_infrared_map, -0.25, -0.25)), 0.6, 0.003);
  EXPECT_NEAR((1 - s.roughness) * at(*s.gloss_map, 0.25, 0.25) / 255, 0.0, 0.003);
  EXPECT_NEAR((1 - s.roughness) * at(*s.gloss_map, 0.25, 0.75) / 255, 0.5, 0.003);
}

TEST(GroundPlane, NoiseDarkensByItsContrastAtMost) {
  const auto one = grey("a", 0.6F);
  EXPECT_EQ(ground_surface({.even = one, .odd = one}).surface, one);
  const auto noisy = ground_surface({.noise_contrast = 0.5, .even = one, .odd = one});
  float least = 1, most = 0, mean = 0;
  const auto& rgba = noisy.surface->colour_map->rgba;
  for (std::size_t i = 0; i < rgba.size(); i += 4) {
    const float v = linear(rgba[i]);
    least = std::min(least, v);
    most = std::max(most, v);
    mean += v / static_cast<float>(rgba.size() / 4);
  }
  EXPECT_GE(least, 0.497F);
  EXPECT_LT(least, 0.56F);
  EXPECT_GT(most, 0.94F);
  EXPECT_NEAR(mean, 0.75, 0.03);
}

class BodyNodes : public testing::Test {
 protected:
  BodyNodes() {
    EXPECT_TRUE(world::define_semantic_types(*db));
    std::vector<std::shared_ptr<ContentProvider>> providers;
    providers.push_back(make_body_provider("."));
    view = std::make_unique<WorldView>(*db, std::move(providers));
  }
  std::unique_ptr<world::Database> db = world::Database::create();
  std::unique_ptr<WorldView> view;
};

TEST_F(BodyNodes, AMovingBodyIsWhereItIsAtTheInstantAsked) {
  const world::types::Body t(db->schema());
  auto tx = db->begin();
  const NodeId still = *tx.create(t.type), moving = *tx.create(t.type);
  world::Motion motion;
  motion.velocity_m_per_s = {2, 0, 0};
  ASSERT_TRUE(tx.set(moving, t.motion, motion));
  ASSERT_TRUE(tx.set(moving, t.moves, true));
  ASSERT_TRUE(tx.commit());
  const auto at = [&](double s) {
    return view->collect({.t = BenchTime{} + nanoseconds(static_cast<std::int64_t>(s * 1e9))}).batches;
  };
  const auto first = at(0), second = at(1.5), again = at(0);
  ASSERT_EQ(first.size(), 2U);
  EXPECT_EQ(first[0]->node, still);
  EXPECT_EQ(first[0]->serial, second[0]->serial) << "what stands still costs nothing";
  EXPECT_EQ(second[1]->node, moving);
  EXPECT_NEAR(second[1]->bounds.center().x(), 3, 1e-9);
  EXPECT_NEAR(again[1]->bounds.center().x(), 0, 1e-9);
  EXPECT_EQ(first[1]->prototype, second[1]->prototype) << "its shape stays the same object";
}

TEST_F(BodyNodes, AChangedSizeIsSeenAndAPoseKeepsTheShape) {
  const world::types::Body t(db->schema());
  auto tx = db->begin();
  const NodeId node = *tx.create(t.type);
  ASSERT_TRUE(tx.commit());
  const auto shape = view->collect({}).batches.at(0)->prototype;
  auto move = db->begin();
  world::Pose pose = world::Pose::Identity();
  pose.translation().x() = 1e5;
  ASSERT_TRUE(move.set(node, t.pose, pose));
  ASSERT_TRUE(move.commit());
  EXPECT_EQ(view->collect({}).batches.at(0)->prototype, shape);
  EXPECT_NEAR(view->collect({}).batches.at(0)->bounds.max().x(), 100000.5, 1e-9);
  auto grow = db->begin();
  ASSERT_TRUE(grow.set(node, t.size_m, world::Vector3(4, 1, 1)));
  ASSERT_TRUE(grow.commit());
  EXPECT_NEAR(view->collect({}).batches.at(0)->bounds.max().x(), 100002, 1e-9);
}

TEST_F(BodyNodes, LampsShineFromTheirPose) {
  const world::types::Lamp t(db->schema());
  auto tx = db->begin();
  const NodeId lamp = *tx.create(t.type), dark = *tx.create(t.type);
  world::Pose pose = world::Pose::Identity();
  pose.translation() = Eigen::Vector3d(1, 2, 3);
  ASSERT_TRUE(tx.set(lamp, t.pose, pose));
  ASSERT_TRUE(tx.set(lamp, t.radiant_intensity_w_per_sr, world::Numbers{1, 2, 3, 4, 5, 6}));
  ASSERT_TRUE(tx.commit());
  (void)dark;
  const auto frame = view->collect({});
  ASSERT_EQ(frame.lamps.size(), 1U);
  EXPECT_EQ(frame.lamps[0].position, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(frame.lamps[0].radiant_intensity[5], 6);
}

}  // namespace
}  // namespace rigor::render
