// What stands between light and a surface, against closed forms.
#include <set>

#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

class LightShadowTest : public LightTest {
 protected:
  void SetUp() override {
    LightTest::SetUp();
    ground_ = one(plane_mesh(500, surface_of(0.5F)), 1);
  }
  /// Rays straight down at places.
  std::vector<LightSample> down_at_all(const std::vector<Vector3d>& places, double up_m = 0.5) {
    std::vector<Ray> rays;
    for (const Vector3d& p : places) rays.push_back(ray_of(p + Vector3d(0, 0, up_m), -Vector3d::UnitZ()));
    return trace(rays);
  }
  std::shared_ptr<Batch> ground_;
};

TEST_F(LightShadowTest, TheShadowOfABoxEndsWhereGeometryHasIt) {
  set_sun(90, 30, 1);  // in the east: the shadow lies to the west
  frame_.batches = {ground_, one(box_mesh({1, 2, 1.5F}, surface_of(0.5F)), 2, {0, 0, 1.5})};
  const double tip = -1 - 3 / std::tan(deg(30));
  const auto l = down_at_all({{tip + 2e-3, 0, 0},
                              {tip - 2e-3, 0, 0},
                              {-2, 2 - 2e-3, 0},
                              {-2, 2 + 2e-3, 0},
                              {-1 - 1e-3, 0, 0},
                              {1 + 1e-3, 0, 0}});
  const double lit = 0.5 / kPi * std::sin(deg(30));
  EXPECT_EQ(l[0].radiance[0], 0);
  EXPECT_NEAR(l[1].radiance[0], lit, 1e-6);
  EXPECT_EQ(l[2].radiance[0], 0);
  EXPECT_NEAR(l[3].radiance[0], lit, 1e-6);
  EXPECT_EQ(l[4].radiance[0], 0);            // at the foot of the side away from the sun
  EXPECT_NEAR(l[5].radiance[0], lit, 1e-6);  // and of the one towards it
  // Far from the world's origin too.
  const Vector3d far(4.5e5, 5.4e6, 800);
  frame_.batches = {one(plane_mesh(500, surface_of(0.5F)), 1, far),
                    one(box_mesh({1, 2, 1.5F}, surface_of(0.5F)), 2, far + Vector3d(0, 0, 1.5))};
  query_.origin = far;
  const auto there = down_at_all({{tip + 5e-3, 0, 0}, {tip - 5e-3, 0, 0}});
  EXPECT_EQ(there[0].radiance[0], 0);
  EXPECT_NEAR(there[1].radiance[0], lit, 1e-6);
}

TEST_F(LightShadowTest, NothingShadesItself) {
  // Light at grazing incidence on flat and on round things, near and far from the scene's origin.
  for (const double elevation : {1.0, 20.0}) {
    set_sun(37, elevation, 1);
    frame_.batches = {ground_};
    std::vector<Vector3d> places;
    for (int i = 0; i < 40; ++i)
      for (int j = 0; j < 40; ++j) places.emplace_back(-400 + 20.3 * i, -400 + 20.7 * j, 0);
    const double lit = 0.5 / kPi * std::sin(deg(elevation));
    for (const LightSample& s : down_at_all(places)) ASSERT_NEAR(s.radiance[0], lit, 1e-6);
  }
}

TEST_F(LightShadowTest, WhatCastsNoShadowDoesNotAndHolesLetLightThrough) {
  set_sun(0, 90, 1);
  const double lit = 0.5 / kPi;
  auto board = prototype_of(plane_mesh(1, surface_of(0.5F), 2));
  frame_.batches = {ground_, batch_of(board, {at(0, 0, 0)}, 2)};
  EXPECT_EQ(down_at(0, 0).radiance[0], 0);
  query_.shadows = false;
  EXPECT_NEAR(down_at(0, 0).radiance[0], lit, 1e-6);
  query_.shadows = true;
  auto through = std::make_shared<Prototype>(*board);
  through->serial = next_serial();
  through->casts_shadow = false;
  frame_.batches[1] = batch_of(through, {at(0, 0, 0)}, 2);
  EXPECT_NEAR(down_at(0, 0).radiance[0], lit, 1e-6);
  // The west half of the board is cut out.
  std::vector<std::uint8_t> rgba;
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x)
      rgba.insert(rgba.end(), {255, 255, 255, x < 4 ? std::uint8_t{0} : std::uint8_t{255}});
  auto cut = surface_of(0.5F);
  cut->colour_map = texture_of(8, 8, rgba);
  cut->alpha_cutoff = 0.5F;
  frame_.batches[1] = one(plane_mesh(1, cut, 2), 2);
  EXPECT_NEAR(down_at(-0.5, 0).radiance[0], lit, 1e-6);
  EXPECT_EQ(down_at(0.5, 0).radiance[0], 0);
}

TEST_F(LightShadowTest, ASunWithASizeGivesHalfOfItsLightAtAShadowsEdge) {
  set_sun(90, 30, 1);
  frame_.light.sun_angular_radius_rad = 0.02F;
  frame_.batches = {ground_, one(box_mesh({1, 200, 1.5F}, surface_of(0.5F)), 2, {0, 0, 1.5})};
  const double tip = -1 - 3 / std::tan(deg(30));
  query_.sun_rays = SunRays::to_points;
  const auto mean_at = [&](double x) {
    std::vector<Vector3d> places(4000, Vector3d(x, 0, 0));
    double sum = 0;
    for (const LightSample& s : down_at_all(places)) sum += static_cast<double>(s.radiance[0]);
    return sum / 4000 / (0.5 / kPi * std::sin(deg(30)));
  };
  EXPECT_NEAR(mean_at(tip), 0.5, 3 * 0.5 / std::sqrt(4000.0));
  // Half a radius off the edge, across the light: a segment of the disc is hidden.
  const double h = 0.5, hidden = (std::acos(h) - h * std::sqrt(1 - h * h)) / kPi;
  const double off = 3 / std::sin(deg(30)) * 0.02 * h / std::sin(deg(30));
  EXPECT_NEAR(mean_at(tip - off), 1 - hidden, 3 * std::sqrt(hidden * (1 - hidden) / 4000) + 0.01);
  EXPECT_NEAR(mean_at(tip - 5 * off), 1, 1e-6);
  EXPECT_NEAR(mean_at(tip + 5 * off), 0, 1e-6);
}

TEST_F(LightShadowTest, RaysToTheSkyFindTheHalfThatAWallLeaves) {
  frame_.light.sky = even_sky(2);
  query_.sky_rays = 4;
  query_.bounces = 0;
  frame_.batches = {ground_, one(box_mesh({2000, 1, 2000}, surface_of(0)), 2, {0, 1 + 1e-2, 2000})};
  const auto mean_of = [&](std::uint64_t seed, double& sigma) {
    query_.seed = seed;
    const auto all = down_at_all(std::vector<Vector3d>(1000, Vector3d::Zero()));
    double sum = 0, squares = 0;
    for (const LightSample& s : all) {
      const double r = static_cast<double>(s.radiance[0]) / (0.5 * 2);
      sum += r;
      squares += r * r;
    }
    sigma = std::sqrt((squares / 1000 - sum * sum * 1e-6) / 1000);
    return sum / 1000;
  };
  double total = 0, sigma = 0, first = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const double m = mean_of(seed, sigma);
    if (seed == 0) first = m;
    EXPECT_NEAR(sigma, 0.5 / std::sqrt(4.0 * 1000), 0.001) << "a ray finds sky or does not";
    EXPECT_NEAR(m, 0.5, 4 * sigma) << seed;
    total += m / 20;
  }
  EXPECT_NEAR(total, 0.5, 3 * sigma / std::sqrt(20.0));
  EXPECT_EQ(mean_of(0, sigma), first) << "the same seed, the same rays";
  // A wall that is not black sends on the half of the sky that it sees itself, less what the ground hides.
  query_.bounces = 1;
  frame_.batches[1] = one(box_mesh({2000, 1, 2000}, surface_of(0.6F)), 2, {0, 1 + 1e-2, 2000});
  EXPECT_NEAR(mean_of(3, sigma), 0.5 + 0.5 * 0.6 * 0.5, 4 * sigma);
  // And of the sun on it, all that falls on it.
  frame_.light.sky = even_sky(0);
  set_sun(180, 40, 3);
  query_.shadows = true;
  const double open = 0.5 / kPi * 3 * std::sin(deg(40)), wall = 0.6 / kPi * 3 * std::cos(deg(40));
  EXPECT_NEAR(mean_of(4, sigma) * 0.5 * 2, open + 0.5 * 0.5 * wall, 4 * sigma);
}

TEST_F(LightShadowTest, WithoutSkyRaysLightIsGatheredFromWhatStandsAround) {
  frame_.light.sky = even_sky(2);
  frame_.batches = {ground_, one(box_mesh({2000, 5, 2000}, surface_of(0.5F)), 2, {0, 5, 2000})};
  const auto mean_at = [&](double y) {
    query_.origin = {0, y, 1};
    std::vector<Ray> rays;
    for (int i = 0; i < 40; ++i)
      for (int j = 0; j < 40; ++j)
        rays.push_back(ray_of(Vector3d::Zero(), Vector3d(0.01 * (i - 20), 0.01 * (j - 20), -1)));
    double sum = 0;
    for (const LightSample& s : trace(rays)) sum += static_cast<double>(s.radiance[0]) / 1600;
    return sum;
  };
  query_.spread_rad = 0.002F;
  query_.gathered = true;
  // Ground and wall of reflectance r that meet see half of the sky and half of each other, whatever the
  // distance: E = pi L (1/2) / (1 - r/2).
  EXPECT_NEAR(mean_at(-1), 0.5 * 2 * 0.5 / (1 - 0.25), 0.03);
  EXPECT_NEAR(mean_at(-3), 0.5 * 2 * 0.5 / (1 - 0.25), 0.03);
  // With the sun on the wall, all of the light that it throws down as well.
  set_sun(180, 40, 3);
  frame_.light.sky = even_sky(0);
  const double wall = 0.5 * 3 * std::cos(deg(40)), ground = 0.5 * 3 * std::sin(deg(40));
  // B = E_sun r + r/2 B_other on both.
  EXPECT_NEAR(mean_at(-1) * kPi, (ground + 0.25 * wall) / (1 - 0.0625), 0.04);
  query_.gathered = false;
  frame_.light.sky = even_sky(2);
  frame_.light.sun_irradiance = {};
  EXPECT_NEAR(mean_at(-1), 0.5 * 2, 1e-3);
}

TEST_F(LightShadowTest, GatheringAddsNoNoiseInTheOpen) {
  // Brighter in the east: paths that differ in direction find different light.
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 16;
  for (int j = 0; j < 16; ++j)
    for (int i = 0; i < 64; ++i)
      sky->radiance.push_back(grey(1 + 0.9F * static_cast<float>(std::sin(deg(i * 360.0 / 64)))));
  frame_.light.sky = sky;
  frame_.batches = {ground_};
  const float open = down_at(0, 0).radiance[0];
  query_.gathered = true;
  EXPECT_NEAR(down_at(0, 0).radiance[0], open, 1e-5F * open);
}

TEST_F(LightShadowTest, WhatIsGatheredDoesNotDependOnWhatWasSeenBefore) {
  query_.gathered = true;
  frame_.light.sky = even_sky(2);
  std::vector<Vector3d> places;
  for (int i = 0; i < 30; ++i)
    for (int j = 0; j < 30; ++j) places.emplace_back(-15 + i * 1.03, -15 + j * 1.07, 0);
  const auto values = [&](LightTracer& tracer) {
    std::vector<Ray> rays;
    for (const Vector3d& p : places)
      rays.push_back(ray_of(p - query_.origin + Vector3d(0, 0, 0.5), -Vector3d::UnitZ()));
    std::vector<float> out;
    for (const LightSample& s : trace(*engine_, tracer, rays)) out.push_back(s.radiance[0]);
    return out;
  };
  auto thing = prototype_of(box_mesh({1, 2, 3}, surface_of(0.5F)));
  const auto with_bounds = [&](float x, float y) {
    auto b = batch_of(thing, {at(x, y, 3)}, 2);
    b->bounds = {Vector3d(x - 1, y - 2, 0), Vector3d(x + 1, y + 2, 6)};
    return b;
  };
  const auto still = with_bounds(-6, 3);
  std::set<std::vector<float>> seen;
  for (const auto& [x, eye] :
       {std::pair{0.0F, 0.0}, {0.0F, 7.3}, {4.0F, 7.3}, {4.5F, -61.0}, {4.5F, 300.0}, {4.5F, 2.0}}) {
    frame_.batches = {ground_, still, with_bounds(x, 1)};
    query_.origin = {eye, 0.5 * eye, 0};
    const auto kept = values(*tracer_);
    LightTracer fresh(engine_);
    EXPECT_EQ(kept, values(fresh)) << x << " " << eye;
    seen.insert(kept);
  }
  EXPECT_GE(seen.size(), 3U);  // three places of the thing, and one so far off that none is known
}

TEST_F(LightShadowTest, GatheredLightIsKeptWhileWhatStandsStillDoes) {
  query_.gathered = true;
  query_.origin = {0.2, 0.3, 1.5};
  frame_.light.sky = even_sky(2);
  const auto box = one(box_mesh({1, 0.1F, 1}, surface_of(0.5F)), 2, {0, 3, 1});
  std::vector<Ray> rays;
  for (int i = 0; i < 100; ++i) rays.push_back(ray_of({0, 0, 0}, {0.02 * i - 1, 1, -0.5}));
  const auto traced = [&] { return tracer_->statistics().gathered_sectors; };
  frame_.batches = {ground_, box};
  trace(rays);
  EXPECT_GT(traced(), 0U);
  trace(rays);
  EXPECT_EQ(traced(), 0U);
  query_.origin += Vector3d(0.3, 0.1, -0.2);  // in the same cell
  trace(rays);
  EXPECT_EQ(traced(), 0U);
  query_.origin += Vector3d(0.5, 0, 0);
  trace(rays);
  EXPECT_GT(traced(), 0U);
  frame_.batches = {ground_};
  trace(rays);
  EXPECT_GT(traced(), 0U);
  set_sun(180, 40, 3);
  trace(rays);
  EXPECT_GT(traced(), 0U);
}

TEST_F(LightShadowTest, WhatMovesShadesTheLightThatIsKeptAndHasLightOfItsOwn) {
  query_.gathered = true;
  query_.origin = {0, 0, 1.5};
  query_.spread_rad = 0.004F;
  frame_.light.sky = even_sky(2);
  // A roof over the place that is looked at, and a block beside it.
  const auto thing = [&](bool moves, double x) {
    auto b = one(box_mesh({3, 3, 0.05F}, surface_of(0.1F)), 2, {x, 6, 1.2});
    b->moves = moves;
    return b;
  };
  const auto block = [&](bool moves) {
    auto b = one(box_mesh({0.5F, 0.5F, 0.5F}, surface_of(0.8F)), 3, {3, 4, 0.5});
    b->moves = moves;
    return b;
  };
  std::vector<Ray> rays;
  for (int i = 0; i < 30; ++i)
    for (int j = 0; j < 30; ++j) rays.push_back(ray_of({0, 0, 0}, {0.04 * i - 0.3, 1, -0.3 - 0.004 * j}));
  const auto mean_with = [&](const std::vector<std::shared_ptr<const Batch>>& things) {
    frame_.batches = {ground_};
    for (const auto& t : things) frame_.batches.push_back(t);
    double sum = 0;
    for (const LightSample& s : trace(rays)) sum += static_cast<double>(s.radiance[0]) / 900;
    return sum;
  };
  const double open = mean_with({}), standing = mean_with({thing(false, 0), block(false)});
  EXPECT_LT(standing, 0.8 * open);
  const double moving = mean_with({thing(true, 0), block(true)});
  EXPECT_NEAR(moving, standing, 0.08 * open);
  // Gone, nothing of it is left.
  EXPECT_NEAR(mean_with({thing(true, 400)}), open, 0.01 * open);
  EXPECT_EQ(mean_with({thing(true, 0), block(true)}), moving);
  LightTracer fresh(engine_);
  double sum = 0;
  for (const LightSample& s : trace(*engine_, fresh, rays)) sum += static_cast<double>(s.radiance[0]) / 900;
  EXPECT_EQ(sum, moving);
}

TEST_F(LightShadowTest, CamerasOfOneInstantShareWhatIsGatheredAboutThingsThatMove) {
  query_.gathered = true;
  query_.origin = {0.2, 0.3, 1.5};
  query_.spread_rad = 0.004F;
  frame_.light.sky = even_sky(2);
  const auto roof = prototype_of(box_mesh({3, 3, 0.05F}, surface_of(0.4F)));
  // As each camera has it from the world: another batch of the same thing.
  const auto show = [&](double x) {
    auto b = batch_of(roof, {at(0, 0, 0)}, 2, {x, 6, 1.2});
    b->moves = true;
    frame_.batches = {ground_, b};
  };
  std::vector<Ray> left, right;
  for (int i = 0; i < 30; ++i)
    for (int j = 0; j < 30; ++j) {
      left.push_back(ray_of({0, 0, 0}, {0.04 * i - 0.3, 1, -0.3 - 0.004 * j}));
      right.push_back(ray_of({0.1, 0, 0}, {0.04 * i - 0.3, 1, -0.3 - 0.004 * j}));
    }
  const auto as_fresh = [&](const std::vector<Ray>& rays) {
    const auto values = [&](LightTracer& tracer) {
      std::vector<float> out;
      for (const LightSample& s : trace(*engine_, tracer, rays)) out.push_back(s.radiance[0]);
      return out;
    };
    const auto kept = values(*tracer_);
    const std::size_t asked = tracer_->statistics().moved_sectors;
    LightTracer fresh(engine_);
    EXPECT_EQ(kept, values(fresh));
    return asked;
  };
  show(0);
  EXPECT_GT(as_fresh(left), 0U);
  show(0);
  EXPECT_EQ(as_fresh(right), 0U);
  show(0.1);
  EXPECT_GT(as_fresh(left), 0U);
  for (Ray& r : right) r.time = 0.5F;  // at another instant of the exposure
  EXPECT_GT(as_fresh(right), 0U);
}

class LightInAnEvenSky : public LightShadowTest {
 protected:
  void SetUp() override {
    LightShadowTest::SetUp();
    frame_.light.sky = even_sky(2);
    frame_.light.ground_albedo = grey(1);  // as bright below the horizon
    query_.spread_rad = 0.01F;
  }
  /// Sheets above each other, of leaves that absorb nothing, with normals that are bent by so much.
  void add_leaves(float half_m, float bent, int sheets, float apart_m) {
    auto leaf = surface_of(0.5F);
    leaf->transmittance = grey(0.5F);
    leaf->two_sided = true;
    for (int i = 0; i < sheets; ++i) {
      auto mesh = plane_mesh(half_m, leaf, apart_m * static_cast<float>(i));
      for (Vertex& v : mesh->vertices) {
        v.normal[0] = bent;
        v.normal[2] = std::sqrt(1 - bent * bent);
      }
      frame_.batches.push_back(one(mesh, static_cast<std::uint64_t>(i + 1)));
    }
  }
  double mean_of(const std::vector<Ray>& rays) {
    double sum = 0;
    for (const LightSample& l : trace(rays))
      sum += static_cast<double>(l.radiance[0]) / static_cast<double>(rays.size());
    return sum;
  }
};

TEST_F(LightInAnEvenSky, LeavesThatAbsorbNothingAreAsBrightAsTheSky) {
  query_.origin = {0, 0, 3};
  std::vector<Ray> rays;
  for (int i = 0; i < 40; ++i)
    for (int j = 0; j < 40; ++j) rays.push_back(ray_of({0, 0, 0}, {0.02 * (i - 20), 0.02 * (j - 20), -1}));
  for (const float bent : {0.0F, 0.5F, 0.9F}) {
    frame_.batches.clear();
    add_leaves(5, bent, 6, 0.3F);
    query_.gathered = false;
    query_.sky_rays = 4;
    query_.bounces = 64;
    EXPECT_NEAR(mean_of(rays), 2, 0.05) << bent;
    query_.gathered = true;
    query_.sky_rays = 0;
    EXPECT_NEAR(mean_of(rays), 2, 0.1) << bent;
  }
}

TEST_F(LightInAnEvenSky, LeavesAndTheFloorBesideThemCountAlikeInTheCellsTheyShare) {
  frame_.batches = {one(plane_mesh(20, surface_of(1), -0.3F), 99)};
  add_leaves(1, 0, 6, 0.3F);
  query_.origin = {0, -4, 1};
  query_.gathered = true;
  std::vector<Ray> rays;
  for (int i = 0; i < 60; ++i)
    for (int j = 0; j < 60; ++j) rays.push_back(ray_of({0, 0, 0}, {0.01 * (i - 30), 1, -0.4 + 0.01 * j}));
  EXPECT_NEAR(mean_of(rays), 2, 0.02);
}

TEST_F(LightShadowTest, MoreSkyRaysBringLessNoise) {
  frame_.light.sky = even_sky(2);
  frame_.batches = {ground_, one(box_mesh({2000, 5, 2000}, surface_of(0.5F)), 2, {0, 5, 2000})};
  query_.bounces = 16;
  const auto noise_with = [&](int sky_rays) {
    query_.sky_rays = sky_rays;
    double sum = 0, squares = 0;
    for (const LightSample& l : trace(std::vector<Ray>(2000, ray_of({0, -2, 1}, {0, 0, -1})))) {
      const auto v = static_cast<double>(l.radiance[0]);
      sum += v / 2000;
      squares += v * v / 2000;
    }
    return std::sqrt(squares - sum * sum);
  };
  EXPECT_NEAR(noise_with(16), noise_with(1) / 4, 0.1 * noise_with(1));
}

TEST_F(LightShadowTest, ARoofWithoutABackHidesNoSkyFromBelow) {
  frame_.light.sky = even_sky(2);
  frame_.batches = {ground_, one(plane_mesh(50, surface_of(0.5F), 3), 2)};
  query_.origin = {0, 0, 1};
  query_.gathered = true;
  EXPECT_NEAR(down_at(0, 0).radiance[0], 0.5 * 2, 1e-4);
}

TEST_F(LightShadowTest, FarGapsInARoofLightTheFloorEvenlyFromPlaceToPlace) {
  frame_.light.sky = even_sky(8);
  // One texel of eight is open, and the roof is black: so much of the sky reaches the floor.
  auto roof = surface_of(0);
  std::vector<std::uint8_t> rgba;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x)
      rgba.insert(rgba.end(), {255, 255, 255, (x + 3 * y) % 8 == 0 ? std::uint8_t{0} : std::uint8_t{255}});
  roof->colour_map = texture_of(64, 64, rgba);
  roof->alpha_cutoff = 0.5F;
  roof->two_sided = true;
  frame_.batches = {one(plane_mesh(2000, surface_of(0.5F), 0), 1), one(plane_mesh(2000, roof, 500), 2)};
  query_.origin = {0, 0, 2};
  query_.spread_rad = 0.004F;
  query_.gathered = true;
  std::vector<Ray> rays;
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 100; ++j) rays.push_back(ray_of({0, 0, 0}, {0.01 * (i - 50), 0.01 * (j - 50), -1}));
  double sum = 0, squares = 0;
  for (const LightSample& l : trace(rays)) {
    sum += static_cast<double>(l.radiance[0]) / 10000;
    squares += static_cast<double>(l.radiance[0]) * static_cast<double>(l.radiance[0]) / 10000;
  }
  EXPECT_NEAR(sum, 0.5 * 8 / 8, 0.02);
  EXPECT_LT(std::sqrt(squares - sum * sum), 0.13 * sum);  // by paths alone: 0.17
}

TEST_F(LightShadowTest, BothSidesOfALeafAskForTheirSky) {
  frame_.light.sky = even_sky(2);
  auto s = surface_of(0.1F);
  s->transmittance = grey(0.4F);
  s->two_sided = true;
  // A black floor below: only the upper side gets light.
  frame_.batches = {one(plane_mesh(1, s, 1), 1), one(plane_mesh(5000, surface_of(0), 0), 2)};
  query_.sky_rays = 8;
  const std::vector<Ray> above(2000, ray_of({0, 0, 2}, {0, 0, -1})),
      below(2000, ray_of({0, 0, 0.5}, {0, 0, 1}));
  const auto mean_of = [&](const std::vector<Ray>& rays) {
    double sum = 0;
    for (const LightSample& l : trace(rays)) sum += static_cast<double>(l.radiance[0]) / 2000;
    return sum;
  };
  EXPECT_NEAR(mean_of(above), 0.1 * 2, 3 * 0.4 / std::sqrt(16000.0));
  EXPECT_NEAR(mean_of(below), 0.4 * 2, 3 * 0.4 / std::sqrt(16000.0));
}

TEST_F(LightShadowTest, TheSameSamplesOnAnyNumberOfThreads) {
  set_sun(120, 35, 3);
  frame_.light.sky = even_sky(1);
  frame_.light.ground_albedo = grey(0.2F);
  std::vector<Instance> boxes;
  for (int i = 0; i < 50; ++i)
    boxes.push_back(at(static_cast<float>(i % 7) * 1.7F, static_cast<float>(i / 7) * 1.3F, 0.2F));
  frame_.batches = {ground_,
                    batch_of(prototype_of(box_mesh({0.3F, 0.4F, 0.7F}, surface_of(0.5F))), boxes, 2)};
  query_.sky_rays = 2;
  query_.sun_rays = SunRays::to_points;
  std::vector<Ray> rays;
  for (int i = 0; i < 3000; ++i)
    rays.push_back(
        ray_of({5, -8, 5}, {0.0007 * (i % 60) - 0.4 + 0.01 * (i / 60), 1, -0.2 - 0.01 * (i % 50)}));
  const auto bytes_with = [&](int threads) {
    auto engine = make({.threads = threads});
    LightTracer tracer(engine);
    const auto all = trace(*engine, tracer, rays);
    std::vector<float> out;
    for (const LightSample& s : all) {
      out.insert(out.end(), s.radiance, s.radiance + 4);
      out.push_back(s.range_m);
    }
    return out;
  };
  const auto single = bytes_with(1);
  EXPECT_EQ(single, bytes_with(3));
  EXPECT_EQ(single, bytes_with(0));
}

TEST_F(LightShadowTest, RaysThatNobodyAskedForAreNotShot) {
  frame_.light.sky = even_sky(1);
  frame_.batches = {ground_};
  down_at(0, 0);
  EXPECT_EQ(tracer_->statistics().shadow_rays, 0U);  // no sun
  EXPECT_EQ(tracer_->statistics().sky_rays, 0U);
  set_sun(0, 45, 1);
  down_at(0, 0);
  EXPECT_EQ(tracer_->statistics().shadow_rays, 1U);
  query_.sky_rays = 5;
  query_.shadows = false;
  down_at(0, 0);
  EXPECT_EQ(tracer_->statistics().shadow_rays, 0U);
  EXPECT_EQ(tracer_->statistics().sky_rays, 5U);
}

}  // namespace
}  // namespace rigor::test
