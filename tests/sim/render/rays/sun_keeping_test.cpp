// Sunlight that is kept in cells of triangles, and the share of a ray's width that is sky.
#include "sim/render/rays/sun_keeping.h"

#include <numeric>
#include <random>
#include <set>

#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

using light::KeptSun;
using light::middle_of;
using light::sun_cell;
using light::SunCell;
using light::Vec3;

RayScene::Triangle triangle_of(Vec3 a, Vec3 b, Vec3 c) { return {a, b - a, c - a}; }
Intersection met_at(float u, float v, std::uint32_t triangle = 3) {
  Intersection m;
  m.range_m = 1, m.u = u, m.v = v;
  m.instance = 7, m.part = 1, m.triangle = triangle;
  return m;
}

/// Of a cell the place that is taken for it lies on the triangle, and is no farther from the cell's middle
/// than half its diagonal: the point that was met is not nearer than that.
void expect_near_middle(const RayScene::Triangle& t, float u, float v, float width_m) {
  const SunCell cell = sun_cell(t, met_at(u, v), width_m);
  ASSERT_TRUE(cell.any());
  EXPECT_GE(cell.side_m, 0.7F * width_m);
  EXPECT_LE(cell.side_m, 1.42F * width_m);
  const Vec3 x = unit(t.e1, {1, 0, 0}), n = unit(cross(t.e1, t.e2), {0, 0, 1}), y = cross(n, x);
  const float column = static_cast<float>(cell.column) + 0.5F, row = static_cast<float>(cell.row) + 0.5F;
  const Vec3 of_cell = t.corner + x * (column * cell.side_m) + y * (row * cell.side_m);
  const Vec3 place = middle_of(t, cell);
  const float rounding = 1e-4F * (1 + length(t.e1) + length(t.e2));
  EXPECT_LE(length(place - of_cell), 0.7072F * cell.side_m + rounding);
  EXPECT_LE(std::abs(dot(n, place - t.corner)), rounding);
  const auto inside = [&](Vec3 from, Vec3 edge) {
    return dot(cross(n, unit(edge, {1, 0, 0})), place - from) >= -rounding;
  };
  EXPECT_TRUE(inside(t.corner, t.e1));
  EXPECT_TRUE(inside(t.corner + t.e1, t.e2 - t.e1));
  EXPECT_TRUE(inside(t.corner + t.e2, -t.e2));
}

TEST(SunCell, IsSquareAndItsPlaceIsOnTheTriangleNearItsMiddle) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> at(-2, 2), share(0, 1);
  for (int n = 0; n < 2000; ++n) {
    const auto t = triangle_of({at(random), at(random), at(random)}, {at(random), at(random), at(random)},
                               {at(random), at(random), at(random)});
    float u = share(random), v = share(random);
    if (u + v > 1) u = 1 - u, v = 1 - v;
    expect_near_middle(t, u, v, 0.01F + 0.3F * share(random));
  }
}

TEST(SunCell, OfTrunksKerbsAndBladesIsWhereThePointIsInAnyOrderOfTheirCorners) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> share(0, 1);
  const Vec3 shapes[][3] = {{{0, 0, 0}, {2, 0, 0}, {0, 0.1F, 0}},
                            {{0, 0, 0}, {4, 0, 0}, {0, 0.05F, 0}},
                            {{0, 0, 0}, {0.3F, 0, 0}, {0.1F, 0.01F, 0}},
                            {{0, 0, 0}, {1, 0, 0}, {10, 0.1F, 0}}};
  for (const auto& shape : shapes)
    for (int first = 0; first < 3; ++first) {
      const auto t = triangle_of(shape[first], shape[(first + 1) % 3], shape[(first + 2) % 3]);
      for (int n = 0; n < 200; ++n) {
        float u = share(random), v = share(random);
        if (u + v > 1) u = 1 - u, v = 1 - v;
        expect_near_middle(t, u, v, 0.12F);
      }
    }
}

TEST(SunCell, PointsShareOneWhereNearAndOtherTrianglesHaveOthers) {
  const auto t = triangle_of({0, 0, 0}, {1, 0, 0}, {0, 1, 0});
  const SunCell cell = sun_cell(t, met_at(0.30F, 0.30F), 0.125F);
  EXPECT_EQ(cell.column, 2);
  EXPECT_EQ(cell.row, 2);
  EXPECT_TRUE(cell.same_as(sun_cell(t, met_at(0.26F, 0.37F), 0.125F)));
  EXPECT_FALSE(cell.same_as(sun_cell(t, met_at(0.24F, 0.30F), 0.125F)));
  EXPECT_FALSE(cell.same_as(sun_cell(t, met_at(0.30F, 0.30F, 4), 0.125F)));
  EXPECT_FALSE(cell.same_as(sun_cell(t, met_at(0.30F, 0.30F), 0.5F)));
}

TEST(SunCell, NoneWhereThereIsNoAreaNoWidthOrNoNumberOfCells) {
  const auto t = triangle_of({0, 0, 0}, {1, 0, 0}, {0, 1, 0});
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  for (const float width_m : {0.0F, -1.0F, nan, 1e-9F, 1e-7F}) {
    EXPECT_FALSE(sun_cell(t, met_at(0.3F, 0.3F), width_m).any()) << width_m;
  }
  EXPECT_FALSE(sun_cell(triangle_of({0, 0, 0}, {0, 0, 0}, {0, 1, 0}), met_at(0.3F, 0.3F), 0.1F).any());
  EXPECT_FALSE(sun_cell(triangle_of({0, 0, 0}, {1, 0, 0}, {2, 0, 0}), met_at(0.3F, 0.3F), 0.1F).any());
  EXPECT_FALSE(sun_cell(triangle_of({0, 0, 0}, {inf, 0, 0}, {0, 1, 0}), met_at(0.3F, 0.3F), 0.1F).any());
  EXPECT_FALSE(sun_cell(t, met_at(nan, 0.3F), 0.1F).any());
  EXPECT_FALSE(sun_cell(triangle_of({0, 0, 0}, {9000, 0, 0}, {0, 1, 0}), met_at(0.9F, 0.1F), 0.001F).any());
  EXPECT_TRUE(sun_cell(triangle_of({0, 0, 0}, {900, 0, 0}, {0, 1, 0}), met_at(0.9F, 0.1F), 0.001F).any());
}

TEST(KeptSun, FindsWhatWasKeptUnderTheSameSunAlone) {
  const auto t = triangle_of({0, 0, 0}, {100, 0, 0}, {0, 100, 0});
  const auto cell_at = [&](int i, int j) {
    return sun_cell(
        t, met_at(0.001F * (static_cast<float>(i) + 0.5F), 0.001F * (static_cast<float>(j) + 0.5F)), 0.0625F);
  };
  KeptSun kept;
  ASSERT_TRUE(kept.about(5, {0, 0, 1}, 0.005F));
  std::vector<float> shares;
  std::size_t found = 0;
  for (int i = 0; i < 300; ++i)
    for (int j = 0; j < 300; ++j) {
      const float share = static_cast<float>((7 * i + 11 * j) % 100) / 99.0F;
      EXPECT_FALSE(kept.find(cell_at(i, j)).has_value());
      shares.push_back(kept.keep(cell_at(i, j), {share, true}).clear);
      EXPECT_NEAR(shares.back(), share, 1e-5F);
    }
  for (int i = 0; i < 300; ++i)
    for (int j = 0; j < 300; ++j)
      if (const auto share = kept.find(cell_at(i, j))) {
        ++found;
        ASSERT_EQ(share->clear, shares[static_cast<std::size_t>(300 * i + j)]);
        ASSERT_TRUE(share->leaves);
      }
  EXPECT_GT(found, 85'000U);  // of 90 000: some have lost their slot to others
  for (int k = 0; k < 3; ++k) {
    ASSERT_TRUE(kept.about(k == 0 ? 6 : 5, {k == 1 ? 1e-6F : 0, 0, 1}, k == 2 ? 0.0051F : 0.005F));
    for (int i = 0; i < 300; ++i) EXPECT_FALSE(kept.find(cell_at(i, i)).has_value()) << k;
  }
  ASSERT_TRUE(kept.about(5, {0, 0, 1}, 0.005F));
  for (const float share : {0.0F, 1.0F}) {
    EXPECT_EQ(kept.keep(cell_at(3, 5), {share, true}).clear, share);
    EXPECT_EQ(kept.find(cell_at(3, 5))->clear, share);
    EXPECT_TRUE(kept.find(cell_at(3, 5))->leaves);
  }
  EXPECT_FALSE(kept.keep(cell_at(3, 5), {1, false}).leaves);
  EXPECT_FALSE(kept.find(cell_at(3, 5))->leaves);
}

/// A grove of leaves with holes above a ground.
class KeptSunlightTest : public LightTest {
 protected:
  void SetUp() override {
    LightTest::SetUp();
    set_sun(140, 50, 3);
    frame_.light.sun_angular_radius_rad = 0.00465F;
    query_.spread_rad = 0.004F;
    query_.sun_rays = SunRays::wide;
    leaf_ = surface_of(0.4F);
    leaf_->transmittance = grey(0.2F);
    leaf_->two_sided = true;
    leaf_->alpha_cutoff = 0.5F;
    std::vector<std::uint8_t> rgba;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x)
        rgba.insert(rgba.end(),
                    {255, 255, 255, static_cast<std::uint8_t>((x * x + 3 * y) % 7 < 4 ? 255 : 0)});
    leaf_->colour_map = texture_of(64, 64, rgba);
    const auto card = prototype_of(plane_mesh(0.5F, leaf_));
    std::mt19937 random(7);
    std::uniform_real_distribution<float> across(-4, 4), up(0.5F, 4), turns(-1, 1);
    std::vector<Instance> cards;
    for (int i = 0; i < 150; ++i) {
      cards.push_back(test::at(across(random), across(random), up(random)));
      test::turn(cards.back(),
                 Eigen::Quaternionf(turns(random), turns(random), turns(random), turns(random)).normalized());
    }
    ground_ = one(plane_mesh(200, surface_of(0.5F)), 1);
    grove_ = batch_of(card, cards, 2);
    frame_.batches = {ground_, grove_};
  }
  static std::vector<Ray> rays_from(double x, double y) {
    std::vector<Ray> rays;
    for (int v = 0; v < 48; ++v)
      for (int u = 0; u < 64; ++u)
        rays.push_back(ray_of({x, y, 2}, {0.02 * (u - 32), 1, -0.3 - 0.02 * (v - 24)}));
    return rays;
  }
  std::vector<float> light_of(EmbreeEngine& engine, LightTracer& tracer, const std::vector<Ray>& rays) {
    std::vector<float> out;
    for (const LightSample& s : trace(engine, tracer, rays)) out.push_back(s.radiance[0]);
    return out;
  }
  double mean_of(const std::vector<float>& v) {
    return std::accumulate(v.begin(), v.end(), 0.0) / static_cast<double>(v.size());
  }
  std::shared_ptr<Batch> ground_, grove_;
  std::shared_ptr<Surface> leaf_;
};

TEST_F(KeptSunlightTest, IsTheSameWhateverWasSeenBeforeAndOnAnyNumberOfThreads) {
  const std::vector<Ray> rays = rays_from(0, -7);
  const std::vector<float> fresh = light_of(*engine_, *tracer_, rays);
  EXPECT_GT(std::set<float>(fresh.begin(), fresh.end()).size(), 500U);
  EXPECT_EQ(light_of(*engine_, *tracer_, rays), fresh);
  for (const int threads : {1, 3}) {
    auto engine = make({.threads = threads});
    LightTracer tracer(engine);
    // Eyes beside it know some of the cells before.
    for (const double x : {-0.3, 0.02, 0.1}) light_of(*engine, tracer, rays_from(x, -7));
    EXPECT_EQ(light_of(*engine, tracer, rays), fresh) << threads;
  }
}

TEST_F(KeptSunlightTest, ShootsFewerRaysTheSecondTimeAndFromBeside) {
  light_of(*engine_, *tracer_, rays_from(0, -7));
  const std::size_t first = tracer_->statistics().shadow_rays;
  EXPECT_GT(first, 300U);
  light_of(*engine_, *tracer_, rays_from(0.01, -7));
  EXPECT_LT(tracer_->statistics().shadow_rays, 3 * first / 4);
  light_of(*engine_, *tracer_, rays_from(0, -7));
  EXPECT_LT(tracer_->statistics().shadow_rays, first / 2);  // of points that no leaf shades
}

TEST_F(KeptSunlightTest, FollowsSunAndContentAndWhatMoves) {
  const std::vector<Ray> rays = rays_from(0, -7);
  const auto expect_as_fresh = [&](const char* what) {
    LightTracer fresh(engine_);
    const std::vector<float> kept = light_of(*engine_, *tracer_, rays);
    EXPECT_EQ(kept, light_of(*engine_, fresh, rays)) << what;
    return kept;
  };
  const auto open = expect_as_fresh("as it is");
  auto roof = one(box_mesh({5, 5, 0.1F}, surface_of(0.5F)), 9, {0, 0, 6});
  frame_.batches.push_back(roof);
  const auto shaded = expect_as_fresh("a roof");
  EXPECT_LT(mean_of(shaded), 0.8 * mean_of(open));
  roof = std::make_shared<Batch>(*roof);
  roof->serial = next_serial();
  roof->moves = true;
  frame_.batches.back() = roof;
  const auto moving = expect_as_fresh("a roof that moves");
  EXPECT_NEAR(mean_of(moving), mean_of(shaded), 0.01 * mean_of(open));
  frame_.batches.pop_back();
  EXPECT_EQ(expect_as_fresh("gone again"), open);
  set_sun(220, 50, 3);
  EXPECT_NE(expect_as_fresh("another sun"), open);
}

TEST_F(KeptSunlightTest, WhatMovesHasTheShadeOfWhereItIs) {
  set_sun(0, 90, 3);
  const auto board = one(plane_mesh(0.5F, leaf_), 10, {-1, 0.41, 8});
  const auto top_of_block_at = [&](float x) {
    auto block = one(box_mesh({0.2F, 0.2F, 0.5F}, surface_of(0.5F)), 9, {static_cast<double>(x), 0.3, 0.5});
    block->moves = true;
    frame_.batches = {ground_, board, block};
    return light_of(*engine_, *tracer_, {ray_of({static_cast<double>(x), 0.31, 3}, -Vector3d::UnitZ())})[0];
  };
  const float below_leaves = top_of_block_at(-1), beside = top_of_block_at(1);
  EXPECT_GT(below_leaves, 0.3F * beside);
  EXPECT_LT(below_leaves, 0.8F * beside);
  EXPECT_EQ(top_of_block_at(-1), below_leaves);
}

TEST_F(KeptSunlightTest, EdgesOfShadowsOfWhatHasNoHolesAreSharp) {
  // Cells of 125 mm, along the axes south of the ground's diagonal.
  query_.spread_rad = 0.08F;
  set_sun(0, 90, 3);
  frame_.light.sun_angular_radius_rad = 0;
  frame_.batches = {ground_, one(box_mesh({1, 5, 0.1F}, surface_of(0.5F)), 9, {1.03, 0, 3})};
  const auto at = [&](double x) {
    return light_of(*engine_, *tracer_, {ray_of({x, -3, 0.5}, -Vector3d::UnitZ())})[0];
  };
  for (const double x : {0.001, 0.02, 0.029}) EXPECT_GT(at(x), 0.1F) << x;
  for (const double x : {0.031, 0.05, 0.12}) EXPECT_EQ(at(x), 0) << x;
}

TEST_F(KeptSunlightTest, EdgesAreSharpAmongSomeLeavesInWhateverOrderTheyAreMet) {
  query_.spread_rad = 0.08F;
  set_sun(0, 90, 3);
  frame_.light.sun_angular_radius_rad = 0;
  const auto at = [&](double x) {
    return light_of(*engine_, *tracer_, {ray_of({x, -3.013, 0.5}, -Vector3d::UnitZ())})[0];
  };
  const auto leaves_at = [&](double height_m) { return one(plane_mesh(0.5F, leaf_), 10, {0, -3, height_m}); };
  // On which side the box is decides how Embree sorts it and the leaves, and so which a ray meets first.
  for (const double side : {-1.0, 1.0})
    for (const double height_m : {2.0, 4.0}) {  // before the box and behind it
      const auto box = one(box_mesh({1, 5, 0.1F}, surface_of(0.5F)), 9, {side * 1.03, 0, 3});
      frame_.batches = {ground_, leaves_at(height_m), box};
      // Cells of 125 mm: the middle of the one from 0 on is behind the box, whose edge is at 30 mm.
      float brightest = 0;
      for (int i = 0; i < 10; ++i) {
        brightest = std::max(brightest, at(side * (0.002 + 0.0027 * i)));
        EXPECT_EQ(at(side * (0.032 + 0.009 * i)), 0) << side << " " << height_m;
      }
      EXPECT_GT(brightest, 0.1F) << side << " " << height_m;
      // Where leaves alone hide it, the box does not count.
      std::vector<std::shared_ptr<const Batch>> thick{ground_, box};
      for (int k = 0; k < 12; ++k) {
        Instance card = test::at(0, -3, static_cast<float>(height_m + 0.02 * k));
        test::turn(card,
                   Eigen::Quaternionf(Eigen::AngleAxisf(0.3F * static_cast<float>(k), Vector3f::UnitZ())));
        thick.push_back(batch_of(prototype_of(plane_mesh(0.5F, leaf_)), {card}, 11));
      }
      frame_.batches = thick;
      at(side * 0.06);
      at(side * 0.07);
      // The second has the first one's answer.
      EXPECT_EQ(tracer_->statistics().shadow_rays, 0U) << side << " " << height_m;
    }
}

TEST_F(KeptSunlightTest, DoesNotDependOnHowThingsWereNumberedBefore) {
  // Instances lose their numbers when a batch before them shrinks, and get them back when an eye has been in
  // two other cells of the world.
  const auto some = [&](std::size_t count) {
    std::vector<Instance> cards(grove_->instances.begin(),
                                grove_->instances.begin() + static_cast<std::ptrdiff_t>(count));
    return batch_of(grove_->prototype, cards, 2);
  };
  const auto rest = batch_of(
      grove_->prototype, std::vector<Instance>(grove_->instances.begin() + 20, grove_->instances.end()), 3);
  const std::vector<Ray> rays = rays_from(0, -7);
  frame_.batches = {some(10), rest, ground_};
  light_of(*engine_, *tracer_, rays);
  frame_.batches[0] = some(8);
  const auto before = light_of(*engine_, *tracer_, rays);
  for (const double x : {600.0, 1200.0}) {
    query_.origin = {x, 0, 0};
    light_of(*engine_, *tracer_, rays);
  }
  query_.origin = Vector3d::Zero();
  EXPECT_EQ(light_of(*engine_, *tracer_, rays), before);
  auto engine = make();
  LightTracer tracer(engine);
  EXPECT_EQ(light_of(*engine, tracer, rays), before);
}

TEST_F(KeptSunlightTest, IsAllThereWithoutShadowsAndNoneWithoutASun) {
  const std::vector<Ray> rays = rays_from(0, -7);
  const double shaded = mean_of(light_of(*engine_, *tracer_, rays));
  query_.shadows = false;
  EXPECT_GT(mean_of(light_of(*engine_, *tracer_, rays)), 1.2 * shaded);
  query_.shadows = true;
  frame_.light.sun_irradiance = {};
  EXPECT_EQ(mean_of(light_of(*engine_, *tracer_, rays)), 0);
}

TEST_F(KeptSunlightTest, OfARayWithoutWidthIsTracedEachTime) {
  query_.spread_rad = 0;
  const std::vector<Ray> rays = rays_from(0, -7);
  const std::vector<float> fresh = light_of(*engine_, *tracer_, rays);
  const std::size_t first = tracer_->statistics().shadow_rays;
  EXPECT_GT(first, 500U);
  EXPECT_EQ(light_of(*engine_, *tracer_, rays), fresh);
  EXPECT_EQ(tracer_->statistics().shadow_rays, first);
}

class SkyShareTest : public LightTest {
 protected:
  void SetUp() override {
    LightTest::SetUp();
    frame_.light.sky = even_sky(2);
    query_.sky_only = true;
    query_.spread_rad = 0.05F;
    leaves_ = surface_of(0.5F);
    leaves_->two_sided = true;
    leaves_->alpha_cutoff = 0.5F;
    std::vector<std::uint8_t> rgba;
    for (int y = 0; y < 256; ++y)
      for (int x = 0; x < 256; ++x)
        rgba.insert(rgba.end(), {255, 255, 255, static_cast<std::uint8_t>((x + y) % 2 == 0 ? 255 : 0)});
    leaves_->colour_map = texture_of(256, 256, rgba);
  }
  LightSample up(std::vector<std::shared_ptr<const Batch>> things) {
    frame_.batches = std::move(things);
    return light({0.31, 0.17, 0}, Vector3d::UnitZ());
  }
  std::shared_ptr<Batch> board(double height_m) { return one(plane_mesh(2, leaves_), 2, {0, 0, height_m}); }
  std::shared_ptr<Surface> leaves_;
};

TEST_F(SkyShareTest, IsWhatLeavesLeaveFreeOfTheRaysWidth) {
  EXPECT_EQ(up({}).sky_share, 1);
  EXPECT_EQ(up({}).radiance[0], 2);
  // 16 mm to a texel; 0.25 m wide at 5 m.
  const LightSample half = up({board(5)}), quarter = up({board(5), board(6)});
  EXPECT_NEAR(half.sky_share, 0.5, 0.02);
  EXPECT_NEAR(quarter.sky_share, 0.25, 0.02);
  EXPECT_EQ(half.radiance[0], 2);  // of the sky, not of the mean
  EXPECT_TRUE(std::isinf(half.range_m));
}

TEST_F(SkyShareTest, IsNothingBehindWhatHasNoHoles) {
  const LightSample s = up({one(box_mesh({2, 2, 0.1F}, surface_of(0.5F)), 3, {0, 0, 5}), board(6)});
  EXPECT_EQ(s.sky_share, 0);
  EXPECT_EQ(s.radiance[0], 0);
  EXPECT_EQ(s.range_m, 0);
}

TEST_F(SkyShareTest, IsAllOfItFromInsideAHullWithOneSide) {
  for (const bool holed : {false, true}) {
    auto s = std::make_shared<Surface>(*leaves_);
    s->serial = next_serial();
    s->two_sided = false;
    if (!holed) s->colour_map = nullptr;
    EXPECT_EQ(up({one(box_mesh({1, 1, 1}, s), 3)}).sky_share, 1) << holed;
  }
}

TEST_F(SkyShareTest, KnowsWhatMoves) {
  for (const bool holed : {false, true}) {
    auto b = holed ? board(5) : one(box_mesh({2, 2, 0.1F}, surface_of(0.5F)), 3, {0, 0, 5});
    b->moves = true;
    EXPECT_NEAR(up({b}).sky_share, holed ? 0.5 : 0, 0.02) << holed;
    EXPECT_NEAR(up({b, board(6)}).sky_share, holed ? 0.25 : 0, 0.02) << holed;
  }
}

TEST_F(SkyShareTest, OfAWholeSampleIsAllOrNothing) {
  query_.sky_only = false;
  EXPECT_EQ(up({}).sky_share, 1);
  EXPECT_EQ(up({one(box_mesh({2, 2, 0.1F}, surface_of(0.5F)), 3, {0, 0, 5})}).sky_share, 0);
}

}  // namespace
}  // namespace rigor::test
