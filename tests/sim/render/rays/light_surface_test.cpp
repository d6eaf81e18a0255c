// Light that a surface sends to an eye, against closed forms.
#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

using LightSurfaceTest = LightTest;

TEST_F(LightSurfaceTest, MattGroundUnderTheSunFollowsLambertInEachBand) {
  auto s = std::make_shared<Surface>();
  s->reflectance = {0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F};
  frame_.batches = {one(plane_mesh(50, s), 7)};
  for (const double elevation : {90.0, 45.0, 10.0, 0.5}) {
    frame_.light.direction_to_sun = direction(200, elevation);
    frame_.light.sun_irradiance = {1, 2, 3, 4, 5, 6};
    query_.bands = {5, 0, 3, 1};
    const LightSample l = down_at(3, 4);
    const double c = std::sin(deg(elevation)) / kPi;
    EXPECT_NEAR(l.radiance[0], 0.6 * 6 * c, 1e-6) << elevation;
    EXPECT_NEAR(l.radiance[1], 0.1 * 1 * c, 1e-6) << elevation;
    EXPECT_NEAR(l.radiance[2], 0.4 * 4 * c, 1e-6) << elevation;
    EXPECT_NEAR(l.radiance[3], 0.2 * 2 * c, 1e-6) << elevation;
    EXPECT_NEAR(l.range_m, 1, 1e-6);
    EXPECT_EQ(l.node.value, 7U);
  }
  set_sun(200, -5, 5);
  EXPECT_EQ(down_at(0, 0).radiance[1], 0);
}

TEST_F(LightSurfaceTest, AnEvenSkyLightsByHowMuchOfItIsSeen) {
  frame_.light.sky = even_sky(2);
  frame_.batches = {one(plane_mesh(50, surface_of(0.5F)), 1)};
  EXPECT_NEAR(down_at(0, 0).radiance[0], 0.5 * 2, 1e-4);
  // A wall sees half of it, and half of a ground that sends back 0.2 of what falls on it.
  frame_.light.ground_albedo = grey(0.2F);
  frame_.batches = {one(box_mesh({5, 1, 5}, surface_of(0.5F)), 2)};
  EXPECT_NEAR(light({0, -10, 0}, {0, 1, 0}).radiance[0], 0.5 * (0.5 * 2 + 0.5 * 0.2 * 2), 2e-3);
}

TEST_F(LightSurfaceTest, MapsTintsAndBandsMultiplyAsTheContractSays) {
  const auto map = texture_of(1, 1, {51, 102, 204, 255}), nir = texture_of(1, 1, {255, 128, 0, 255});
  auto s = std::make_shared<Surface>();
  s->reflectance = {0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F};
  s->colour_map = map;
  frame_.light.sun_irradiance = {1, 2, 3, 4, 5, 6};
  frame_.light.direction_to_sun = {0, 0, 1};
  Instance i = at(0, 0, 0);
  i.tint[0] = 0.5F;
  i.tint[1] = 1.0F;
  i.tint[2] = 0.9F;
  const double mean = (0.2 + 0.4 + 0.8) / 3, tint = (0.5 + 1 + 0.9) / 3;
  const auto expect = [&](const std::shared_ptr<Surface>& surface, const std::array<double, 4>& e) {
    frame_.batches = {batch_of(prototype_of(plane_mesh(50, surface)), {i}, 1)};
    const LightSample l = down_at(0, 0);
    for (std::size_t c = 0; c < 4; ++c) EXPECT_NEAR(l.radiance[c], e[c] / kPi, 1e-6) << c;
  };
  expect(s, {0.1 * 0.2 * 0.5 * 1, 0.2 * 0.4 * 1 * 2, 0.3 * 0.8 * 0.9 * 3, 0.4 * mean * tint * 4});
  query_.bands = {4, 5, 1, 3};
  expect(s, {0.5 * mean * tint * 5, 0.6 * mean * tint * 6, 0.2 * 0.4 * 2, 0.4 * mean * tint * 4});
  auto both = std::make_shared<Surface>(*s);
  both->serial = next_serial();
  both->near_infrared_map = nir;
  expect(both, {0.5 * 128 / 255 * tint * 5, 0, 0.2 * 0.4 * 2, 0.4 * tint * 4});
  auto nir_alone = std::make_shared<Surface>(*both);
  nir_alone->serial = next_serial();
  nir_alone->colour_map = nullptr;
  expect(nir_alone, {0.5 * 128 / 255 * tint * 5, 0, 0.2 * 2, 0.4 * tint * 4});
}

TEST_F(LightSurfaceTest, AMapIsAsCoarseAsTheRaySeesIt) {
  // 64 x 64 squares, black and white: near by one of them, far away their mean in linear light.
  std::vector<std::uint8_t> rgba;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      const std::uint8_t v = (x + y) % 2 == 0 ? 255 : 0;
      rgba.insert(rgba.end(), {v, v, v, 255});
    }
  auto s = surface_of(1);
  s->colour_map = texture_of(64, 64, rgba, true);
  set_sun(0, 90, static_cast<float>(kPi));
  frame_.batches = {one(plane_mesh(32, s), 1)};  // a metre a square
  query_.spread_rad = 0.1F;                      // a tenth of a square
  EXPECT_NEAR(light({0.5, 0.5, 1}, {0, 0, -1}).radiance[0] + light({1.5, 0.5, 1}, {0, 0, -1}).radiance[0], 1,
              1e-4);
  EXPECT_NEAR(std::abs(light({0.5, 0.5, 1}, {0, 0, -1}).radiance[0] - 0.5F), 0.5, 1e-4);
  query_.spread_rad = 0;
  EXPECT_NEAR(std::abs(light({0.5, 0.5, 500}, {0, 0, -1}).radiance[0] - 0.5F), 0.5, 1e-4);
  query_.spread_rad = 0.02F;  // ten squares
  EXPECT_NEAR(light({0.5, 0.5, 500}, {0, 0, -1}).radiance[0], 0.5, 3e-3);
}

TEST_F(LightSurfaceTest, ANormalMapTiltsTowardsGrowingUAndThePicturesTop) {
  auto s = surface_of(0.5F);
  const auto along = [](double x, double y, double z) {
    const auto byte = [](double v) { return static_cast<std::uint8_t>(std::lround((v + 1) * 127.5)); };
    return std::vector<std::uint8_t>{byte(x), byte(y), byte(z), 255};
  };
  const auto lit = [&](double sun_azimuth, double x, double y) {
    auto bumpy = std::make_shared<Surface>(*s);
    bumpy->serial = next_serial();
    bumpy->normal_map = texture_of(1, 1, along(x, y, std::sqrt(1 - x * x - y * y)));
    frame_.batches = {one(plane_mesh(5, bumpy), 1)};
    set_sun(sun_azimuth, 45, 1);
    return static_cast<double>(down_at(0, 0).radiance[0]) / (0.5 / kPi);
  };
  const double tilt = 0.5, up = std::sqrt(1 - tilt * tilt), r = std::sqrt(0.5);
  EXPECT_NEAR(lit(90, tilt, 0), r * (up + tilt), 0.01);  // u grows towards the east: the sun is there
  EXPECT_NEAR(lit(270, tilt, 0), r * (up - tilt), 0.01);
  EXPECT_NEAR(lit(0, 0, tilt), r * (up + tilt), 0.01);  // the picture's top is north
  EXPECT_NEAR(lit(180, 0, tilt), r * (up - tilt), 0.01);
}

TEST_F(LightSurfaceTest, ALeafIsLitFromBehind) {
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(0.1F);
  s->transmittance = grey(0.3F);
  s->two_sided = true;
  set_sun(0, 60, 5);
  frame_.batches = {one(plane_mesh(5, s), 1)};
  const double e = 5 * std::sin(deg(60));
  EXPECT_NEAR(light({0, 0, 10}, {0, 0, -1}).radiance[0], 0.1 / kPi * e, 1e-6);
  EXPECT_NEAR(light({0, 0, -10}, {0, 0, 1}).radiance[0], 0.3 / kPi * e, 1e-6);
  // Of two leaves, the upper one's shadow lies on the lower one: the sun does not come through as sun.
  frame_.batches.push_back(one(plane_mesh(5, s, 1), 2));
  EXPECT_EQ(light({0, 0, -10}, {0, 0, 1}).radiance[0], 0);
  // By an even sky: what both sides get.
  frame_.batches.resize(1);
  frame_.light.sun_irradiance = {};
  frame_.light.sky = even_sky(2);
  frame_.light.ground_albedo = grey(0.5F);
  EXPECT_NEAR(light({0, 0, 10}, {0, 0, -1}).radiance[0], 0.1 * 2 + 0.3 * 0.5 * 2, 1e-3);
  EXPECT_NEAR(light({0, 0, -10}, {0, 0, 1}).radiance[0], 0.3 * 2 + 0.1 * 0.5 * 2, 1e-3);
}

TEST_F(LightSurfaceTest, LampsFallOffWithTheSquareOfDistanceAndThrowShadows) {
  frame_.batches = {one(plane_mesh(50, surface_of(0.5F)), 1)};
  frame_.lamps = {{{0, 0, 2}, grey(8)}};
  for (const double x : {0.0, 1.0, 2.0, 10.0}) {
    const double d2 = x * x + 4;
    EXPECT_NEAR(down_at(x, 0).radiance[2], 0.5 / kPi * 8 / d2 * 2 / std::sqrt(d2), 1e-6) << x;
  }
  // A board of 0.2 m half way up throws a shadow of 0.4 m.
  frame_.batches.push_back(one(plane_mesh(0.1F, surface_of(0.5F), 1), 2));
  EXPECT_EQ(light({0.199, 0, 0.5}, {0, 0, -1}).radiance[0], 0);
  EXPECT_GT(light({0.201, 0, 0.5}, {0, 0, -1}).radiance[0], 0.3);
  query_.shadows = false;
  EXPECT_GT(light({0.199, 0, 0.5}, {0, 0, -1}).radiance[0], 0.3);
}

TEST_F(LightSurfaceTest, ARetroReflectorSendsLightBackToItsLamp) {
  auto s = surface_of(0);
  s->retro_reflection = 0.5F;
  frame_.batches = {one(plane_mesh(5, s), 1)};
  frame_.lamps = {{{3, 0, 4}, grey(10)}};
  const Vector3d back = Vector3d(-3, 0, -4);
  // Its share of the irradiance, over a cone whose integral is pi times its width squared.
  const double expected = 0.5 * 10 / 25 / (kPi * 0.0087 * 0.0087);
  EXPECT_NEAR(light({3, 0, 4}, back).radiance[0], expected, 1e-3 * expected);
  // All that is sent back, over the directions, is that share of what falls on it.
  double sum = 0;
  const double step = 0.0005;
  for (int i = -80; i <= 80; ++i)
    for (int j = -80; j <= 80; ++j) {
      const Vector3d from =
          Vector3d(3, 0, 4) + 5 * step * (i * Vector3d(-0.8, 0, 0.6) + j * Vector3d(0, 1, 0));
      sum += static_cast<double>(light(from, -from).radiance[0]) * from.normalized().z() * step * step;
    }
  EXPECT_NEAR(sum, 0.5 * 10 / 25 * 0.8, 0.01 * sum);
  EXPECT_LT(light({-3, 0, 4}, {3, 0, -4}).radiance[0], 1e-6);
}

TEST_F(LightSurfaceTest, WaterMirrorsTheSkyByFresnel) {
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 64;
  sky->radiance.resize(64 * 64);
  for (int j = 0; j < 64; ++j)
    for (int i = 0; i < 64; ++i)
      sky->radiance[static_cast<std::size_t>(j * 64 + i)] =
          grey(1 + static_cast<float>(j) / 16 + 0.5F * static_cast<float>(std::sin(deg(i * 360.0 / 64))));
  frame_.light.sky = sky;
  auto s = surface_of(0);
  s->water = true;
  s->roughness = 0.05F;
  frame_.batches = {one(plane_mesh(2000, s), 1)};
  for (const double elevation : {80.0, 20.0, 5.0}) {
    const double c = std::sin(deg(elevation)), f = 0.02 + 0.93 * std::pow(1 - c, 5);
    const double mirrored = static_cast<double>(sky->at(direction(30, elevation))[0]);
    EXPECT_NEAR(light({0, 0, 2}, direction(30, -elevation)).radiance[0], f * mirrored, 2e-3 * f * mirrored)
        << elevation;
  }
}

TEST_F(LightSurfaceTest, PolishedMetalShowsWhatStandsThereWhereRaysAskForIt) {
  auto metal = surface_of(0.8F);
  metal->metallic = 1;
  metal->roughness = 0;
  frame_.light.sky = even_sky(2);
  auto black = surface_of(0), wall = surface_of(0.5F);
  frame_.batches = {one(plane_mesh(5, metal), 1), one(box_mesh({50, 1, 50}, wall), 2, {0, 10, 50})};
  // Off at 45°: the wall, which half the sky lights.
  const Vector3d from(0, -3, 3), off(0, 1, -1);
  const double c = std::sqrt(0.5), f = 0.8 + 0.2 * std::pow(1 - c, 5);
  EXPECT_NEAR(light(from, off).radiance[0], f * 2, 1e-2);  // without rays: the sky
  query_.sky_rays = 16;
  query_.bounces = 0;
  EXPECT_NEAR(light(from, off).radiance[0], 0, 1e-6);
  query_.bounces = 1;
  double sum = 0;
  for (query_.seed = 0; query_.seed < 400; ++query_.seed)
    sum += static_cast<double>(light(from, off).radiance[0]);
  EXPECT_NEAR(sum / 400, f * 0.5 * 2 / 2, 3 * f * 0.5 * 0.5 * 2 / std::sqrt(400.0));
}

TEST_F(LightSurfaceTest, WetSoilIsDarkerAndSnowIsWhite) {
  auto soil = surface_of(0.2F);
  soil->porosity = 1;
  set_sun(0, 90, 1);
  frame_.batches = {one(plane_mesh(5, soil), 1)};
  const double dry = static_cast<double>(down_at(0, 0).radiance[0]);
  frame_.surface.wetness = 1;
  // The sun stands where its highlight is: look from aside.
  const double wet = static_cast<double>(light({-5, 0, 1}, {5, 0, -1}).radiance[0]);
  EXPECT_LT(wet, 0.6 * dry);
  EXPECT_GT(wet, 0.4 * dry);
  frame_.surface = {0, 0.5F};
  query_.bands = {0, 1, 2, 5};
  const LightSample snow = down_at(0, 0);
  EXPECT_NEAR(snow.radiance[0], 0.92 / kPi, 1e-3);
  EXPECT_NEAR(snow.radiance[3], 0.12 / kPi, 1e-3);
}

TEST_F(LightSurfaceTest, NumbersThatAreNoneBringFiniteLight) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  Mesh m;
  add_quad(m, {-5, -5, 0}, {5, -5, 0}, {5, 5, 0}, {-5, 5, 0});
  for (Vertex& v : m.vertices) v.normal[1] = nan;
  auto s = surface_of(0.5F);
  s->roughness = nan;
  frame_.batches = {one(finished(std::move(m), s), 1)};
  set_sun(0, 90, 1);
  EXPECT_NEAR(down_at(0, 0).radiance[0], 0.5 / kPi, 0.02);
  auto bad = std::make_shared<SkyMap>(*even_sky(1));
  bad->radiance[5] = grey(nan);
  frame_.light.sky = bad;
  frame_.light.sun_irradiance[2] = nan;
  frame_.hazes = {{.extinction_per_m = grey(nan)}};
  frame_.lamps = {{{nan, 0, 1}, grey(1)}, {{0, 0, 1}, grey(nan)}};
  query_.sky_rays = 4;
  for (const float r : down_at(0, 0).radiance) EXPECT_TRUE(std::isfinite(r));
  Ray r = ray_of({0, 0, 1}, {0, 0, -1});
  r.direction[0] = nan;
  const LightSample none = trace({r})[0];
  EXPECT_EQ(none.radiance[0], 0);
  EXPECT_TRUE(std::isinf(none.range_m));
}

}  // namespace
}  // namespace rigor::test
