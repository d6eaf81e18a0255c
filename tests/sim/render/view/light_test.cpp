#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

constexpr double kPi = std::numbers::pi;

class ViewLight : public ViewTest {
 protected:
  void look_down() { request_.T_world_camera = look({0, 0, 10}, {0, 0, 0}); }
};

TEST_F(ViewLight, MattGroundUnderTheSunFollowsLambert) {
  look_down();
  for (const double elevation : {90.0, 45.0, 10.0}) {
    set_sun(200, elevation, 5);
    frame_.batches = {one(plane_mesh(50, SurfaceOf::grey(0.3F)), 1)};
    const auto p = shoot();
    EXPECT_NEAR(pixel(p, 80, 60)[1], 0.3 / kPi * 5 * std::sin(deg(elevation)), 1e-4) << elevation;
  }
  set_sun(200, -5, 5);
  EXPECT_NEAR(pixel(shoot(), 80, 60)[1], 0, 1e-6);
}

TEST_F(ViewLight, AnEvenSkyLightsByHowMuchOfItIsSeen) {
  look_down();
  frame_.light.sky = even_sky(2);
  frame_.light.ground_albedo = {};
  frame_.batches = {one(plane_mesh(50, SurfaceOf::grey(0.5F)), 1)};
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.5 * 2, 2e-3);
  // A wall sees half of it, and half of a ground that sends back 0.2 of what falls on it.
  frame_.light.ground_albedo = grey(0.2F);
  frame_.batches = {one(box_mesh({5, 1, 5}, SurfaceOf::grey(0.5F)), 2)};
  request_.T_world_camera = look({0, -10, 0}, {0, 0, 0});
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.5 * (0.5 * 2 + 0.5 * 0.2 * 2), 2e-3);
}

TEST_F(ViewLight, BandsMapsAndTintsMultiplyAsTheContractSays) {
  look_down();
  auto map = std::make_shared<Texture>();
  map->width = map->height = 1;
  map->srgb = false;
  map->rgba = {51, 102, 204, 255};
  auto nir = std::make_shared<Texture>(*map);
  nir->serial = next_serial();
  nir->rgba = {255, 128, 0, 255};
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
  const auto shot = [&](const std::shared_ptr<Surface>& surface) {
    frame_.batches = {batch_of(prototype_of(plane_mesh(50, surface)), {i}, 1)};
    return shoot();
  };
  const auto expect = [&](const ViewPicture& p, const std::array<double, 4>& e) {
    for (int c = 0; c < 4; ++c)
      EXPECT_NEAR(pixel(p, 80, 60)[c], e[static_cast<std::size_t>(c)] / kPi, 2e-4) << c;
  };
  expect(shot(s), {0.1 * 0.2 * 0.5 * 1, 0.2 * 0.4 * 1 * 2, 0.3 * 0.8 * 0.9 * 3, 0.4 * mean * tint * 4});
  request_.bands = {4, 5, 1, 3};
  expect(shot(s), {0.5 * mean * tint * 5, 0.6 * mean * tint * 6, 0.2 * 0.4 * 2, 0.4 * mean * tint * 4});
  auto both = std::make_shared<Surface>(*s);
  both->serial = next_serial();
  both->near_infrared_map = nir;
  expect(shot(both), {0.5 * 128 / 255 * tint * 5, 0, 0.2 * 0.4 * 2, 0.4 * tint * 4});
  auto nir_alone = std::make_shared<Surface>(*both);
  nir_alone->serial = next_serial();
  nir_alone->colour_map = nullptr;
  expect(shot(nir_alone), {0.5 * 128 / 255 * tint * 5, 0, 0.2 * 2, 0.4 * tint * 4});
}

TEST_F(ViewLight, ALeafIsLitFromBehind) {
  look_down();
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(0.1F);
  s->transmittance = grey(0.3F);
  s->two_sided = true;
  set_sun(0, 90, 5);
  frame_.light.ground_albedo = {};
  frame_.batches = {one(plane_mesh(5, s), 1)};
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.1 / kPi * 5, 1e-4);
  request_.T_world_camera = look({0, 0, -10}, {0, 0, 0});
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.3 / kPi * 5, 1e-4);
}

TEST_F(ViewLight, LampsFallOffWithTheSquareOfDistance) {
  request_.T_world_camera = look({0, 0, 6}, {0, 0, 0});
  frame_.batches = {one(plane_mesh(5, SurfaceOf::grey(0.5F)), 1)};
  frame_.lamps = {{{0, 0, 2}, grey(8)}};
  const auto p = shoot();
  EXPECT_NEAR(pixel(p, 80, 60)[2], 0.5 / kPi * 8 / 4, 2e-3);
  // Two metres aside: distance 8, cosine and square as they are. 2 m at 6 m are 50 px.
  const double d2 = 8, cosine = 2 / std::sqrt(8.0);
  EXPECT_NEAR(pixel(p, 129, 60)[2], 0.5 / kPi * 8 / d2 * cosine, 4e-3);
}

TEST_F(ViewLight, TheSunsDiscSendsItsIrradiance) {
  set_sun(90, 20, 4);
  request_.pinhole = pinhole(101, 101, 4000);
  request_.T_world_camera = look({0, 0, 2}, Eigen::Vector3d(0, 0, 2) + direction(90, 20));
  const auto p = shoot();
  double sum = 0;
  for (std::size_t i = 0; i < p.depth_m.size(); ++i)
    sum += static_cast<double>(p.radiance[4 * i]) / (4000.0 * 4000.0);
  EXPECT_NEAR(sum, 4, 0.04);
  save(p, "sun", {.exposure = ToneMapOptions::Exposure::fixed, .scale = 1e-5});
}

TEST_F(ViewLight, WaterMirrorsTheSky) {
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 64;
  sky->radiance.resize(64 * 64);
  for (int j = 0; j < 64; ++j)
    for (int i = 0; i < 64; ++i)
      sky->radiance[static_cast<std::size_t>(j * 64 + i)] = grey(1 + static_cast<float>(j) / 16);
  frame_.light.sky = sky;
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(0);
  s->water = true;
  s->roughness = 0.05F;
  frame_.batches = {one(plane_mesh(2000, s), 1)};
  request_.T_world_camera = look({0, 0, 2}, Eigen::Vector3d(0, 0, 2) + direction(30, -20));
  const auto p = shoot();
  const double c = std::sin(deg(20)), f = 0.02 + 0.98 * std::pow(1 - c, 5);
  const double mirrored = static_cast<double>(sky->at(direction(30, 20))[0]);
  EXPECT_NEAR(pixel(p, 80, 60)[0], f * mirrored, 0.06 * f * mirrored);
}

TEST_F(ViewLight, OnlyWhatTheSceneNeedsIsCompiled) {
  frame_.light.sky = even_sky(1);
  frame_.batches = {one(plane_mesh(50, SurfaceOf::grey(0.3F)), 1)};
  look_down();
  shoot();
  for (const auto& name : view_->pipelines())
    for (const char* word : {"alpha", "haze", "lamps", "particles", "snow", "wet", "shadow", "sway",
                             "impostor", "glossy", "translucent", "map", "tiles"})
      EXPECT_EQ(name.find(word), std::string::npos) << name << " has " << word;
  EXPECT_EQ(view_->pipelines().size(), 3U);  // surface, sky, gather
  frame_.lamps = {{{0, 0, 2}, grey(8)}};
  frame_.hazes.push_back({.extinction_per_m = grey(1e-3F)});
  shoot();
  const auto names = view_->pipelines();
  EXPECT_NE(std::find(names.begin(), names.end(), "surface haze lamps"), names.end());
}

}  // namespace
}  // namespace rigor::test
