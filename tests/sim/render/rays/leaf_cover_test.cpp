// What leaves cover of rays that have a width, against shares counted by hand.
#include "sim/render/rays/leaf_cover.h"

#include <set>

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
  const LeafCover halves(*map_of(128, [](auto x, auto) { return x < 64; }), 0.5F);
  for (const float side : {0.0F, 0.5F, 1.0F, 1.4F, -1.0F}) {
    EXPECT_EQ(halves.leaf_at(0.25F, 0.5F, side), 255) << side;
    EXPECT_EQ(halves.leaf_at(0.75F, 0.5F, side), 0) << side;
  }
  EXPECT_FALSE(halves.hole_at(0.25F, 0.5F));
  EXPECT_TRUE(halves.hole_at(0.75F, 0.5F));
}

/// Share of the map that hole_at() leaves, at nine places of each texel.
double leaf_of(const LeafCover& cover, float low = 0, float high = 1) {
  const auto n = static_cast<int>(3 * std::max(cover.width(), cover.height()));
  int leaf = 0, all = 0;
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const float u = (static_cast<float>(x) + 0.5F) / static_cast<float>(n);
      if (u < low || u > high) continue;
      ++all;
      leaf += cover.hole_at(u, (static_cast<float>(y) + 0.5F) / static_cast<float>(n)) ? 0 : 1;
    }
  return static_cast<double>(leaf) / all;
}

TEST(LeafCover, IsTheShareOfAWiderSquare) {
  const LeafCover halves(*map_of(128, [](auto x, auto) { return x < 64; }), 0.5F),
      fine(*map_of(128, chequered), 0.5F);
  for (const float side : {2.0F, 3.0F, 4.0F, 1e9F})
    EXPECT_NEAR(fine.leaf_at(0.3F, 0.6F, side), 255 * leaf_of(fine), 4) << side;
  // At the edge of a half: half of what a square of four texels about it sees.
  EXPECT_NEAR(halves.leaf_at(0.5F, 0.5F, 4), 128, 1);
  EXPECT_EQ(halves.leaf_at(0.45F, 0.5F, 4), 255);
  EXPECT_EQ(halves.leaf_at(0.55F, 0.5F, 4), 0);
}

TEST(LeafCover, IsWhatPointsSayOnTheMeanWhateverTheMapAndItsCutoff) {
  struct Case {
    std::uint32_t width, height;
    float cutoff;
  };
  for (const Case& c :
       {Case{128, 128, 0.35F}, Case{255, 67, 0.35F}, Case{67, 255, 0.7F}, Case{129, 64, 0.5F}}) {
    // Needles of about two texels, with edges of some coverage, thicker to the right.
    std::vector<std::uint8_t> rgba;
    for (std::uint32_t y = 0; y < c.height; ++y)
      for (std::uint32_t x = 0; x < c.width; ++x) {
        const float across = std::abs(std::fmod(static_cast<float>(y) + 0.3F * static_cast<float>(x), 7.0F) -
                                      3.5F),
                    thick = 0.5F + 1.5F * static_cast<float>(x) / static_cast<float>(c.width);
        rgba.insert(
            rgba.end(),
            {255, 255, 255, static_cast<std::uint8_t>(255 * std::clamp(thick - across + 0.5F, 0.0F, 1.0F))});
      }
    const LeafCover cover(*texture_of(c.width, c.height, rgba), c.cutoff);
    for (const float side : {2.0F, 4.0F})
      for (const float low : {0.1F, 0.4F, 0.7F}) {
        double mean = 0;
        for (int i = 0; i < 100; ++i)
          for (int j = 0; j < 100; ++j)
            mean += cover.leaf_at(low + 0.002F * (static_cast<float>(i) + 0.5F),
                                  0.01F * (static_cast<float>(j) + 0.5F), side) /
                    2.55e6;
        EXPECT_NEAR(mean, leaf_of(cover, low, low + 0.2F), 0.015)
            << c.width << "x" << c.height << " side " << side << " from " << low;
      }
  }
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
  /// Of boards: cells of sunlight on the ground lie beside their diagonal, where a ray meets both triangles.
  static constexpr double kNorth_m = 0.0137;
  void SetUp() override {
    LightTest::SetUp();
    set_sun(0, 90, 1);
    frame_.light.sun_angular_radius_rad = 0.00465F;
    ground_ = one(plane_mesh(500, surface_of(0.5F)), 1);
    query_.spread_rad = 0.001F;
    query_.sun_rays = SunRays::wide;
    leaves_ = surface_of(0.5F);
    leaves_->alpha_cutoff = 0.5F;
    leaves_->colour_map = map_of(256, chequered);
  }
  /// 4 m wide, chequered in squares of 16 mm: at 5 m the sun's disc covers some of them.
  std::shared_ptr<Batch> board(double height_m, float half_m = 2, float scale = 1) {
    Instance i = at(0, 0, 0);
    std::fill_n(i.scale, 3, scale);
    return batch_of(prototype_of(plane_mesh(half_m, leaves_)), {i}, 2, {0, kNorth_m, height_m});
  }
  /// Leaf of the eastern half alone.
  void half_a_map() {
    leaves_->colour_map = map_of(256, [](auto x, auto) { return x >= 128; });
  }
  double share_at(double x, double up_m = 0.5) {
    return static_cast<double>(trace({ray_of({x, 0.3, up_m}, -Vector3d::UnitZ())})[0].radiance[0]) / kLit;
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
  for (const double s : shares()) ASSERT_NEAR(s, 0.5, 0.02);
}

TEST_F(LeafLightTest, AnEdgeIsAsSoftAsTheSunIsWideThere) {
  half_a_map();
  // 21 mm to either side at 5 m, whatever the size of the mesh and its scale, turned, moving or one of many.
  std::vector<std::pair<const char*, std::shared_ptr<Batch>>> boards{
      {"plain", board(5)}, {"small", board(5, 0.02F, 100)}, {"large", board(5, 2000, 0.001F)}};
  boards.emplace_back("moving", board(5));
  boards.back().second->moves = true;
  boards.emplace_back("of many", board(5));
  for (int i = 1; i < 100; ++i)
    boards.back().second->instances.push_back(at(10.0F * static_cast<float>(i), 0, 0));
  for (const auto& [name, b] : boards) {
    frame_.batches = {ground_, b};
    EXPECT_NEAR(share_at(0), 0.5, 0.05) << name;
    EXPECT_GT(share_at(-0.012), 0.6) << name;
    EXPECT_LT(share_at(-0.012), 0.95) << name;
    EXPECT_LT(share_at(0.012), 0.4) << name;
    EXPECT_GT(share_at(0.012), 0.05) << name;
    EXPECT_NEAR(share_at(-0.06), 1, 1e-5) << name;
    EXPECT_EQ(share_at(0.06), 0) << name;
  }
  // Turned by a quarter: the edge lies along x, its leaves to the north.
  auto turned = board(5);
  turn(turned->instances[0],
       Eigen::Quaternionf(Eigen::AngleAxisf(0.5F * static_cast<float>(kPi), Vector3f::UnitZ())));
  frame_.batches = {ground_, turned};
  EXPECT_EQ(share_at(0), 0);
}

TEST_F(LeafLightTest, NearTheGroundAnEdgeIsAsSoftAsThreePixelsAreWide) {
  half_a_map();
  auto beside = board(0.6);
  beside->origin.x() = 0.03;
  frame_.batches = {ground_, beside};
  query_.spread_rad = 0.08F;  // 40 mm of a ray that is met 0.5 m on: cells of 125 mm
  // South of the ground's diagonal: its cells lie along the axes.
  const auto share_at = [&](double x) {
    return static_cast<double>(trace({ray_of({x, -0.3, 0.5}, -Vector3d::UnitZ())})[0].radiance[0]) / kLit;
  };
  EXPECT_NEAR(share_at(0.01), 0.24, 0.03);
  EXPECT_EQ(share_at(0.01), share_at(0.11));
  EXPECT_NEAR(share_at(-0.01), 1, 1e-4);
  EXPECT_EQ(share_at(0.13), 0);
  query_.spread_rad = 0.001F;
  EXPECT_NEAR(share_at(0.01), 1, 1e-4);
  EXPECT_EQ(share_at(0.05), 0);
}

TEST_F(LeafLightTest, ARayWithoutWidthMeetsLeafOrHole) {
  query_.sun_rays = SunRays::to_middle;
  frame_.batches = {ground_, board(5)};
  double sum = 0;
  for (const double s : shares()) {
    ASSERT_TRUE(s == 0 || std::abs(s - 1) < 1e-5) << s;
    sum += s / 1600;
  }
  EXPECT_NEAR(sum, 0.5, 0.1);
  // So it is where leaves are near: their squares are wider than what the ray stands for.
  query_.sun_rays = SunRays::wide;
  frame_.batches = {ground_, board(0.6)};
  for (const double s : shares()) ASSERT_TRUE(s == 0 || std::abs(s - 1) < 1e-5) << s;
}

TEST_F(LeafLightTest, LayersMultiplyAndThickFoliageIsDark) {
  frame_.batches = {ground_};
  for (const double expected : {0.5, 0.25, 0.125, 0.0625, 0.0, 0.0}) {
    frame_.batches.push_back(board(5 + 0.3 * static_cast<double>(frame_.batches.size())));
    for (const double s : shares())
      ASSERT_NEAR(s, expected, 0.02) << frame_.batches.size() - 1 << " boards, least " << kLeastClear;
  }
}

TEST_F(LeafLightTest, WhatHasNoHolesHidesTheSunAmongLeavesToo) {
  frame_.batches = {ground_, board(5), one(box_mesh({2, 2, 0.1F}, surface_of(0.5F)), 3, {0, 0, 6})};
  for (const double s : shares()) ASSERT_EQ(s, 0);
}

TEST_F(LeafLightTest, IsTheSameOnAnyNumberOfThreadsAndInAnyOrderOfBoards) {
  // Boards of other shares, so that a product of floats would depend on the order.
  frame_.batches = {ground_};
  for (std::uint32_t i = 0; i < 6; ++i) {
    leaves_ = std::make_shared<Surface>(*leaves_);
    leaves_->serial = next_serial();
    leaves_->colour_map = map_of(256, [&](auto x, auto y) { return (3 * x + 5 * y) % (4 + i) == 0; });
    frame_.batches.push_back(board(4 + 0.3 * i, 2 + 0.1F * static_cast<float>(i)));
  }
  const std::vector<double> first = shares();
  EXPECT_GT(std::set<double>(first.begin(), first.end()).size(), 100U);
  std::reverse(frame_.batches.begin(), frame_.batches.end());
  for (const int threads : {1, 2, 4}) {
    auto engine = make({.threads = threads});
    EXPECT_EQ(shares(*engine), first) << threads;
  }
}

/// Layers of rays straight down from 10 m, 0.1 m wide where leaves are.
class LeafLayerTest : public LeafLightTest {
 protected:
  struct Layer {
    double range_m, share;
    std::uint64_t node;
  };
  std::vector<std::vector<Layer>> layers(float half_width_m = 0.05F) {
    EXPECT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
    std::vector<Ray> rays;
    for (int i = 0; i < 20; ++i)
      for (int j = 0; j < 20; ++j)
        rays.push_back(ray_of({-1.5 + 0.0713 * i, -1.49 + 0.0697 * j, 10}, -Vector3d::UnitZ()));
    LayeredHits hits;
    hits.resize(rays.size());
    EXPECT_TRUE(engine_->cast_layers({.band = 0, .rays = rays, .half_width_m = half_width_m}, hits));
    std::vector<std::vector<Layer>> out(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i)
      for (const PartialHit& p : hits.of(i))
        out[i].push_back(
            {static_cast<double>(p.hit.range_m), static_cast<double>(p.share), p.hit.node.value});
    return out;
  }
  /// What each ray meets, as ranges and shares.
  void expect(const std::vector<std::pair<double, double>>& wanted) {
    for (const auto& ray : layers()) {
      ASSERT_EQ(ray.size(), wanted.size());
      for (std::size_t k = 0; k < wanted.size(); ++k) {
        ASSERT_NEAR(ray[k].range_m, wanted[k].first, 1e-4) << k;
        ASSERT_NEAR(ray[k].share, wanted[k].second, 0.03) << k;
      }
    }
  }
};

TEST_F(LeafLayerTest, AWideRayMeetsLeavesByTheirShareAndTheRestGoesOn) {
  frame_.batches = {ground_};
  expect({{10, 1}});
  frame_.batches.push_back(board(5));
  expect({{5, 0.5}, {10, 0.5}});
  frame_.batches.push_back(board(6));
  expect({{4, 0.5}, {5, 0.25}, {10, 0.25}});
  EXPECT_EQ(layers()[0][0].node, 2U);
  EXPECT_EQ(layers()[0][2].node, 1U);
  // Nothing behind: that part of a ray brings nothing.
  frame_.batches.erase(frame_.batches.begin());
  expect({{4, 0.5}, {5, 0.25}});
}

TEST_F(LeafLayerTest, WhereLessThanAFifthIsLeftTheLastSurfaceHasTheRest) {
  frame_.batches = {ground_};
  for (int i = 0; i < 5; ++i) frame_.batches.push_back(board(6 - i));
  expect({{4, 0.5}, {5, 0.25}, {6, 0.25}});
}

TEST_F(LeafLayerTest, MoreThinLayersThanAreToldEndAtTheLastOfThem) {
  // A texel in 32: 3 % of the ray each.
  leaves_->colour_map = map_of(256, [](auto x, auto y) { return x % 4 == 0 && y % 8 == 0; });
  frame_.batches = {ground_};
  for (int i = 0; i < 12; ++i) frame_.batches.push_back(board(9 - 0.5 * i));
  for (const auto& ray : layers()) {
    ASSERT_EQ(ray.size(), LayeredHits::kMost);
    double sum = 0;
    for (std::size_t k = 0; k < ray.size(); ++k) {
      ASSERT_NEAR(ray[k].range_m, 1 + 0.5 * static_cast<double>(k), 1e-4);
      sum += ray[k].share;
    }
    ASSERT_NEAR(sum, 1, 1e-5);
    ASSERT_GT(ray.back().share, 0.5);
  }
}

TEST_F(LeafLayerTest, ARayWithoutWidthEndsAtTheFirstLeaf) {
  frame_.batches = {ground_, board(5), board(6)};
  std::set<double> ranges;
  for (const auto& ray : layers(0)) {
    ASSERT_EQ(ray.size(), 1U);
    ASSERT_EQ(ray[0].share, 1);
    ranges.insert(std::round(ray[0].range_m));
  }
  EXPECT_EQ(ranges, (std::set<double>{4, 10}));  // the boards have their leaves in the same places
}

TEST_F(LeafLayerTest, BacksOfLeavesWithOneSideAreNotThere) {
  Mesh m;
  add_quad(m, {-2, 2, 0}, {2, 2, 0}, {2, -2, 0}, {-2, -2, 0});  // looks down
  const auto below = finished(std::move(m), leaves_);
  frame_.batches = {ground_, board(5), one(below, 3, {0, 0, 6})};
  const auto seen = layers();
  frame_.batches = {ground_, board(5)};
  expect({{5, 0.5}, {10, 0.5}});
  for (const auto& ray : seen) {
    ASSERT_EQ(ray.size(), 2U);
    ASSERT_NEAR(ray[0].range_m, 5, 1e-4);
  }
}

TEST_F(LeafLayerTest, AreTheSameInAnyOrderOfBoards) {
  frame_.batches = {ground_};
  for (std::uint32_t i = 0; i < 12; ++i) {
    leaves_ = std::make_shared<Surface>(*leaves_);
    leaves_->serial = next_serial();
    leaves_->colour_map = map_of(256, [&](auto x, auto y) { return (3 * x + 5 * y) % (5 + i) == 0; });
    frame_.batches.push_back(board(4 + 0.3 * ((5 * i) % 12), 2));
  }
  const auto numbers = [&] {
    std::vector<double> out;
    for (const auto& ray : layers())
      for (const Layer& l : ray) out.insert(out.end(), {l.range_m, l.share});
    return out;
  };
  const std::vector<double> first = numbers();
  std::reverse(frame_.batches.begin() + 1, frame_.batches.end());
  EXPECT_EQ(numbers(), first);
  std::rotate(frame_.batches.begin(), frame_.batches.begin() + 5, frame_.batches.end());
  EXPECT_EQ(numbers(), first);
}

TEST_F(LeafLayerTest, RefusesWidthsThatAreNone) {
  EXPECT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
  LayeredHits hits;
  for (const float wrong :
       {-1.0F, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    RayQuery at_start, on_the_way;
    at_start.half_width_m = on_the_way.half_width_per_m = wrong;
    for (const RayQuery& q : {at_start, on_the_way}) {
      const Status s = engine_->cast_layers(q, hits);
      ASSERT_FALSE(s);
      EXPECT_EQ(s.error().code, ErrorCode::bad_input);
    }
  }
}

}  // namespace
}  // namespace rigor::test
