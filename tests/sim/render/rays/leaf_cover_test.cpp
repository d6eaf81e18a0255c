// What leaves cover of rays that have a width, against shares counted by hand.
#include "sim/render/rays/leaf_cover.h"

#include "sim/render/rays/embree_scene.h"
#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

/// White; what `is_leaf` says is there.
template <class F>
std::shared_ptr<Texture> map_of(std::uint32_t side, F&& is_leaf) {
  std::vector<std::uint8_t> rgba;
  for (std::uint32_t y = 0; y < side; ++y)
    for (std::uint32_t x = 0; x < side; ++x)
      rgba.insert(rgba.end(), {255, 255, 255, is_leaf(x, y) ? std::uint8_t{255} : std::uint8_t{0}});
  return texture_of(side, side, rgba);
}
bool chequered(std::uint32_t x, std::uint32_t y) { return (x + y) % 2 == 0; }

TEST(LeafCover, IsLeafOrHoleToWhatIsNotWiderThanATexel) {
  const LeafCover halves(*map_of(64, [](auto x, auto) { return x < 32; }), 0.5F);
  for (const float side : {0.0F, 0.5F, 1.0F, 1.4F, -1.0F}) {
    EXPECT_EQ(halves.leaf_at(0.25F, 0.5F, side), 255) << side;
    EXPECT_EQ(halves.leaf_at(0.75F, 0.5F, side), 0) << side;
  }
  EXPECT_FALSE(halves.hole_at(0.25F, 0.5F));
  EXPECT_TRUE(halves.hole_at(0.75F, 0.5F));
}

TEST(LeafCover, IsTheShareOfAWiderSquare) {
  const LeafCover fine(*map_of(64, chequered), 0.5F),
      quarter(*map_of(64, [](auto x, auto y) { return x % 2 == 0 && y % 2 == 0; }), 0.5F);
  for (const float side : {2.0F, 3.0F, 4.0F, 1e9F}) {
    EXPECT_NEAR(fine.leaf_at(0.3F, 0.6F, side), 128, 1) << side;
    EXPECT_NEAR(quarter.leaf_at(0.3F, 0.6F, side), 64, 1) << side;
  }
  // At the edge of a half: half of what a square of four texels about it sees.
  const LeafCover halves(*map_of(64, [](auto x, auto) { return x < 32; }), 0.5F);
  EXPECT_NEAR(halves.leaf_at(0.5F, 0.5F, 4), 128, 1);
  EXPECT_EQ(halves.leaf_at(0.4F, 0.5F, 4), 255);
  EXPECT_EQ(halves.leaf_at(0.6F, 0.5F, 4), 0);
}

TEST(LeafCover, OfAMapTooSmallForLevelsIsLeafOrHole) {
  const LeafCover small(*map_of(8, chequered), 0.5F), dot(*map_of(1, [](auto, auto) { return true; }), 0.5F);
  for (const float u : {0.1F, 0.4F, 0.8F}) {
    const int leaf = small.leaf_at(u, 0.3F, 100);
    EXPECT_TRUE(leaf == 0 || leaf == 255) << leaf;
    EXPECT_EQ(dot.leaf_at(u, 0.3F, 100), 255);
  }
}

class LeafLightTest : public LightTest {
 protected:
  static constexpr double kLit = 0.5 / kPi;
  void SetUp() override {
    LightTest::SetUp();
    set_sun(0, 90, 1);
    frame_.light.sun_angular_radius_rad = 0.00465F;
    ground_ = one(plane_mesh(500, surface_of(0.5F)), 1);
    query_.spread_rad = 0.005F;
    leaves_ = surface_of(0.5F);
    leaves_->alpha_cutoff = 0.5F;
    leaves_->colour_map = map_of(256, chequered);
  }
  /// 4 m wide, chequered in squares of 16 mm: at 5 m the sun's disc covers some of them.
  std::shared_ptr<Batch> board(double height_m, float half_m = 2, float scale = 1) {
    Instance i = at(0, 0, 0);
    std::fill_n(i.scale, 3, scale);
    return batch_of(prototype_of(plane_mesh(half_m, leaves_)), {i}, 2, {0, 0, height_m});
  }
  /// Of the light without boards, at places below them.
  std::vector<double> shares(EmbreeEngine& engine) {
    LightTracer tracer(engine_ptr(engine));
    std::vector<Ray> rays;  // beside the diagonal of the boards, where a ray meets both triangles
    for (int i = 0; i < 40; ++i)
      for (int j = 0; j < 40; ++j)
        rays.push_back(ray_of({-1.5 + 0.0713 * i, -1.49 + 0.0697 * j, 0.5}, -Vector3d::UnitZ()));
    std::vector<double> out;
    for (const LightSample& s : trace(engine, tracer, rays))
      out.push_back(static_cast<double>(s.radiance[0]) / kLit);
    return out;
  }
  std::vector<double> shares() { return shares(*engine_); }
  std::shared_ptr<EmbreeEngine> engine_ptr(EmbreeEngine& e) {
    return std::shared_ptr<EmbreeEngine>(std::shared_ptr<void>(), &e);
  }
  std::shared_ptr<Batch> ground_;
  std::shared_ptr<Surface> leaves_;
};

TEST_F(LeafLightTest, SunlightThroughFineLeavesIsTheShareThatTheyLeaveFree) {
  frame_.batches = {ground_, board(5)};
  for (const double s : shares()) ASSERT_NEAR(s, 0.5, 0.01);
  // A mesh of another size, scaled to the same.
  frame_.batches = {ground_, board(5, 0.02F, 100)};
  for (const double s : shares()) ASSERT_NEAR(s, 0.5, 0.01);
  frame_.batches = {ground_, board(5, 2000, 0.001F)};
  for (const double s : shares()) ASSERT_NEAR(s, 0.5, 0.01);
}

TEST_F(LeafLightTest, ARayWithoutWidthMeetsLeafOrHole) {
  query_.spread_rad = 0;
  frame_.batches = {ground_, board(5)};
  double sum = 0;
  for (const double s : shares()) {
    ASSERT_TRUE(s == 0 || std::abs(s - 1) < 1e-5) << s;
    sum += s / 1600;
  }
  EXPECT_NEAR(sum, 0.5, 0.1);
  // So it is where leaves are near: their squares are wider than what the ray stands for.
  query_.spread_rad = 0.005F;
  frame_.batches = {ground_, board(0.6)};
  for (const double s : shares()) ASSERT_TRUE(s == 0 || std::abs(s - 1) < 1e-5) << s;
}

TEST_F(LeafLightTest, ThickFoliageIsRightOnTheMean) {
  frame_.batches = {ground_, board(5), board(5.3), board(5.6)};
  double sum = 0;
  std::size_t some = 0;
  const double least = static_cast<double>(kLeastClear);
  for (const double s : shares()) {
    ASSERT_TRUE(s == 0 || std::abs(s - least) < 0.01) << s;
    sum += s / 1600;
    some += s > 0 ? 1 : 0;
  }
  // One in eight: 0.3 with a chance of 0.125 / 0.3.
  const double chance = 0.125 / least, sigma = least * std::sqrt(chance * (1 - chance) / 1600);
  EXPECT_NEAR(sum, 0.125, 4 * sigma);
  EXPECT_GT(some, 0U);
}

TEST_F(LeafLightTest, WhatHasNoHolesHidesTheSunAmongLeavesToo) {
  frame_.batches = {ground_, board(5), one(box_mesh({2, 2, 0.1F}, surface_of(0.5F)), 3, {0, 0, 6})};
  for (const double s : shares()) ASSERT_EQ(s, 0);
}

TEST_F(LeafLightTest, IsTheSameOnAnyNumberOfThreadsAndInAnyOrderOfBoards) {
  frame_.batches = {ground_};
  for (int i = 0; i < 6; ++i) frame_.batches.push_back(board(4 + 0.3 * i, 2 + 0.1F * static_cast<float>(i)));
  const std::vector<double> first = shares();
  std::reverse(frame_.batches.begin(), frame_.batches.end());
  for (const int threads : {1, 2, 4}) {
    auto engine = make({.threads = threads});
    EXPECT_EQ(shares(*engine), first) << threads;
  }
}

}  // namespace
}  // namespace rigor::test
