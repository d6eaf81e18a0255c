// The same small worlds by both engines: rays and the Vulkan view. Radiance agrees pixel by pixel away from
// edges, where each engine has a footprint of its own.
//
// Scenes keep clear of what the two do differently by design: what hides the sky (the view guesses it from a
// map of heights, rays without sky rays leave it out), lamps behind things, levels of maps between their
// sizes.
#include "sim/render/rays/light_picture.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

class LightAgainstView : public ViewTest {
 protected:
  void SetUp() override {
    ViewTest::SetUp();
    if (IsSkipped()) return;
    auto cache = EmbreeCache::create();
    ASSERT_TRUE(cache);
    auto engine = EmbreeEngine::create(*cache, {});
    ASSERT_TRUE(engine);
    engine_ = *engine;
    tracer_ = std::make_unique<LightTracer>(engine_);
  }
  ViewPicture traced() {
    auto window = std::make_shared<ContentWindow>();
    window->frames = {std::make_shared<const ContentFrame>(frame_)};
    EXPECT_TRUE(engine_->prepare(window));
    LightPictureRequest q;
    q.T_world_camera = request_.T_world_camera;
    q.pinhole = request_.pinhole;
    q.bands = request_.bands;
    q.shadows = request_.switches.shadows;
    q.gather = request_.switches.sky_cover;
    ViewPicture p;
    const Status s = trace_picture(*tracer_, q, p);
    EXPECT_TRUE(s) << s.error().text();
    return p;
  }
  struct Difference {
    double worst = 0, rms = 0;  ///< share of the picture's brightest matt thing
    int compared = 0, worst_u = 0, worst_v = 0;
  };
  /// Where all pixels within `clear` show the same thing, and light changes little in both.
  Difference compare(const std::string& name, double scale, int clear = 2, double steady = 0.1) {
    const ViewPicture a = shoot(), b = traced();
    save(a, name + "_view");
    save(b, name + "_rays");
    Difference d;
    double squares = 0;
    const int w = a.width_px, h = a.height_px;
    for (int v = clear; v < h - clear; ++v)
      for (int u = clear; u < w - clear; ++u) {
        bool edge = false;
        for (int j = -clear; j <= clear && !edge; ++j)
          for (int i = -clear; i <= clear && !edge; ++i) {
            edge = node(a, u + i, v + j) != node(a, u, v) || node(b, u + i, v + j) != node(a, u, v);
            for (const ViewPicture* p : {&a, &b})
              for (int c = 0; c < 4; ++c)
                edge =
                    edge || std::abs(static_cast<double>(pixel(*p, u + i, v + j)[c] - pixel(*p, u, v)[c])) >
                                steady * scale;
          }
        if (edge) continue;
        if (node(a, u, v) != 0) {
          EXPECT_NEAR(depth(b, u, v), depth(a, u, v), 1e-3 * static_cast<double>(depth(a, u, v)));
        }
        for (int c = 0; c < 4; ++c) {
          const double e = static_cast<double>(pixel(b, u, v)[c] - pixel(a, u, v)[c]) / scale;
          squares += e * e;
          if (std::abs(e) > d.worst) {
            d.worst = std::abs(e);
            d.worst_u = u;
            d.worst_v = v;
          }
        }
        ++d.compared;
      }
    d.rms = std::sqrt(squares / std::max(4 * d.compared, 1));
    RecordProperty(name, std::to_string(d.worst) + " " + std::to_string(d.rms));
    return d;
  }
  void expect_alike(const std::string& name, double scale, double worst, double rms, int clear = 2,
                    double steady = 0.1) {
    const Difference d = compare(name, scale, clear, steady);
    EXPECT_LT(d.worst, worst) << name << " at " << d.worst_u << ", " << d.worst_v;
    EXPECT_LT(d.rms, rms) << name;
    EXPECT_GT(d.compared, 160 * 120 / 2) << name;
  }
  std::shared_ptr<EmbreeEngine> engine_;
  std::unique_ptr<LightTracer> tracer_;
};

std::shared_ptr<Texture> soft_texture(bool srgb, bool normals = false) {
  auto t = std::make_shared<Texture>();
  t->width = t->height = 64;
  t->srgb = srgb;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      const double a = std::sin(x * 2 * std::numbers::pi / 64), b = std::cos(y * 2 * std::numbers::pi / 64);
      const auto byte = [](double v) { return static_cast<std::uint8_t>(std::lround(255 * v)); };
      if (normals) {
        const Eigen::Vector3d n = Eigen::Vector3d(0.4 * a, 0.3 * b, 1).normalized();
        t->rgba.insert(t->rgba.end(),
                       {byte(0.5 + 0.5 * n.x()), byte(0.5 + 0.5 * n.y()), byte(0.5 + 0.5 * n.z()), 255});
      } else {
        t->rgba.insert(t->rgba.end(),
                       {byte(0.5 + 0.3 * a), byte(0.5 + 0.3 * b), byte(0.5 + 0.2 * a * b), 255});
      }
    }
  return t;
}

TEST_F(LightAgainstView, BoxOnAPlaneInTheSunWithItsShadow) {
  set_sun(120, 40, 3);
  frame_.light.ground_albedo = {};
  auto board = SurfaceOf::grey(0.4F);
  board->reflectance = {0.4F, 0.5F, 0.3F, 0.7F, 0.6F, 0.5F};
  frame_.batches = {one(plane_mesh(40, board), 1),
                    one(box_mesh({1, 1, 1.5F}, SurfaceOf::grey(0.6F)), 2, {0, 0, 1.5})};
  request_.T_world_camera = look({6, -9, 5}, {0, 0, 0.5});
  request_.switches.sky_cover = false;
  // The view's shadows have soft edges, as wide as texels of its map, and faces that the sun grazes lie in
  // a little of their own shadow.
  expect_alike("box", 0.5, 0.02, 1e-3, 4, 0.01);
}

TEST_F(LightAgainstView, OpenSkyOnEverySide) {
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 16;
  for (int j = 0; j < 16; ++j)
    for (int i = 0; i < 64; ++i)
      sky->radiance.push_back(grey(static_cast<float>(1 + 0.5 * std::sin(i * 2 * std::numbers::pi / 64)) +
                                   0.05F * static_cast<float>(j)));
  frame_.light.sky = sky;
  frame_.light.ground_albedo = grey(0.3F);
  set_sun(200, 30, 2);
  request_.switches.shadows = false;  // without its map of heights
  Mesh ball;
  constexpr int kAcross = 48, kUp = 24;
  for (int j = 0; j <= kUp; ++j)
    for (int i = 0; i <= kAcross; ++i) {
      const Eigen::Vector3d n = direction(i * 360.0 / kAcross, -90 + j * 180.0 / kUp);
      Vertex v{};
      for (int k = 0; k < 3; ++k) v.position[k] = v.normal[k] = static_cast<float>(n[k]);
      ball.vertices.push_back(v);
    }
  for (std::uint32_t j = 0; j < kUp; ++j)
    for (std::uint32_t i = 0; i < kAcross; ++i) {
      const std::uint32_t a = j * (kAcross + 1) + i, b = a + 1, c = a + kAcross + 1, d = c + 1;
      ball.indices.insert(ball.indices.end(), {a, c, b, b, c, d});
    }
  ball.bounds = {Eigen::Vector3f(-1, -1, -1), Eigen::Vector3f(1, 1, 1)};
  frame_.batches = {one(finished(ball, SurfaceOf::grey(0.5F)), 1, {0, 0, 1})};
  request_.T_world_camera = look({0, -2.4, 1.4}, {0, 0, 1});
  // The view has the sky's irradiance as a polynomial of second order.
  expect_alike("ball", 0.8, 0.02, 5e-3, 1);
}

TEST_F(LightAgainstView, WhatHidesTheSkyIsGuessedAsItIsGathered) {
  frame_.light.sky = even_sky(1);
  frame_.light.ground_albedo = grey(0.2F);
  auto leaf = SurfaceOf::grey(0.2F);
  leaf->transmittance = grey(0.1F);
  leaf->two_sided = true;
  frame_.batches = {one(plane_mesh(60, SurfaceOf::grey(0.4F)), 1),
                    one(box_mesh({8, 1, 6}, SurfaceOf::grey(0.5F)), 2, {0.1, 6.1, 6}),
                    one(box_mesh({1, 1, 1.5F}, SurfaceOf::grey(0.5F)), 3, {-3.1, 2.1, 1.5})};
  request_.T_world_camera = look({5, -12, 7}, {-1, 3, 1});
  // The view takes a tenth of the sky for what walls throw about, where half of it comes back from them, and
  // what is gathered differs by a few hundredths from draw to draw: the worst pixel has both.
  expect_alike("cover", 0.4, 0.28, 0.1);
  set_sun(160, 50, 2);
  frame_.batches.push_back(one(plane_mesh(3, leaf), 4, {5.1, 0.1, 4.1}));
  expect_alike("canopy", 0.8, 0.3, 0.08, 3, 0.05);
}

TEST_F(LightAgainstView, MapsGlossAndBumps) {
  auto s = std::make_shared<Surface>();
  s->reflectance = {0.8F, 0.7F, 0.6F, 0.9F, 0.5F, 0.5F};
  s->colour_map = soft_texture(true);
  s->near_infrared_map = soft_texture(false);
  s->gloss_map = soft_texture(false);
  frame_.batches = {one(plane_mesh(3, s), 1)};
  frame_.light.sky = even_sky(0.3F);
  set_sun(60, 50, 3);
  request_.T_world_camera = look({0, -4, 4}, {0, 0, 0});
  expect_alike("maps", 0.7, 0.03, 6e-3);
}

TEST_F(LightAgainstView, NormalMapsTiltTheSameWay) {
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(0.5F);
  s->normal_map = soft_texture(false, true);
  frame_.batches = {one(plane_mesh(3, s), 1)};
  for (const double azimuth : {0.0, 90.0, 180.0, 225.0}) {
    set_sun(azimuth, 40, 3);
    request_.T_world_camera = look({0, -2, 5}, {0, 0, 0});
    expect_alike("bumps" + std::to_string(static_cast<int>(azimuth)), 0.5, 0.03, 8e-3);
  }
}

TEST_F(LightAgainstView, HazeAndRain) {
  frame_.light.sky = even_sky(1);
  frame_.light.ground_albedo = grey(0.1F);
  set_sun(150, 20, 2);
  frame_.batches = {one(plane_mesh(400, SurfaceOf::grey(0.3F)), 1),
                    one(box_mesh({4, 4, 8}, SurfaceOf::grey(0.1F)), 2, {-10, 90, 8})};
  frame_.hazes = {{.extinction_per_m = {2e-3F, 4e-3F, 8e-3F, 1e-3F, 1e-3F, 1e-3F},
                   .top_m = 6,
                   .inscattered_radiance = grey(0.6F)},
                  {.extinction_per_m = grey(1e-3F), .inscattered_radiance = grey(0.9F)}};
  frame_.precipitation.kind = Precipitation::Kind::rain;
  frame_.precipitation.extinction_per_m = grey(2e-3F);
  request_.T_world_camera = look({0, 0, 3}, {0, 60, 5});
  request_.switches.shadows = false;
  expect_alike("haze", 1, 0.006, 2e-3, 1);
}

TEST_F(LightAgainstView, ALampOnTheGround) {
  frame_.batches = {one(plane_mesh(20, SurfaceOf::grey(0.5F)), 1)};
  frame_.lamps = {{{0, 0, 2}, {8, 6, 4, 2, 1, 1}}, {{3, 2, 1}, grey(2)}};
  request_.T_world_camera = look({0, -6, 4}, {0, 0, 0});
  expect_alike("lamps", 0.3, 1e-3, 2e-4, 1);
}

TEST_F(LightAgainstView, RetroReflectorsShineInTheLightOfALampBesideTheEye) {
  auto sheeting = SurfaceOf::grey(0.3F);
  sheeting->retro_reflection = 0.4F;
  frame_.batches = {one(plane_mesh(3, sheeting), 1)};
  frame_.lamps = {{{0, -5.9, 4.05}, grey(4)}};
  request_.T_world_camera = look({0, -6, 4}, {0, 2, 0});
  const auto p = shoot();
  // Matt, the sheeting would have at most 0.3 / pi of 4 / 16.
  EXPECT_GT(*std::max_element(p.radiance.begin(), p.radiance.end()), 1.0F);
  expect_alike("sheeting", 20, 1e-3, 2e-4, 1);
}

TEST_F(LightAgainstView, WaterMirrorsALampLessThanPlasticDoes) {
  auto water = SurfaceOf::grey(0.02F);
  water->water = true;
  water->roughness = 0.4F;
  frame_.batches = {one(plane_mesh(10, water), 1)};
  frame_.lamps = {{{0, 6, 4}, grey(4)}};
  request_.T_world_camera = look({0, -6, 4}, {0, 0, 0});
  const auto p = shoot();
  // Matt, it would have at most 0.02 / pi of 4 / 16.
  EXPECT_GT(*std::max_element(p.radiance.begin(), p.radiance.end()), 0.005F);
  expect_alike("lamp_on_water", 0.02, 5e-3, 1e-3, 1);
  auto plastic = SurfaceOf::grey(0.02F);
  plastic->roughness = 0.4F;
  frame_.batches = {one(plane_mesh(10, plastic), 1)};
  const auto q = shoot();
  const float of_water = *std::max_element(p.radiance.begin(), p.radiance.end()),
              of_plastic = *std::max_element(q.radiance.begin(), q.radiance.end());
  // Schlick's term at 56 degrees, of 2 % and of 4 % at right angles.
  EXPECT_NEAR(of_water / of_plastic, 0.0371 / 0.0568, 0.02);
}

TEST_F(LightAgainstView, LeavesInFrontOfTheSun) {
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(0.1F);
  s->transmittance = {0.05F, 0.2F, 0.02F, 0.4F, 0.4F, 0.2F};
  s->two_sided = true;
  frame_.light.sky = even_sky(0.5F);
  frame_.light.ground_albedo = grey(0.2F);
  set_sun(0, 35, 4);
  Instance i = at(0, 3, 2);
  i.rotation[0] = std::sin(0.4F);
  i.rotation[3] = std::cos(0.4F);
  frame_.batches = {batch_of(prototype_of(plane_mesh(1.5F, s)), {i}, 1)};
  request_.switches.shadows = false;
  request_.T_world_camera = look({0, -1, 1.7}, {0, 3, 2});
  expect_alike("leaf", 0.5, 4e-3, 1e-3, 1);
}

TEST_F(LightAgainstView, WetAndSnowyGround) {
  auto s = SurfaceOf::grey(0.3F);
  frame_.batches = {one(plane_mesh(8, s), 1)};
  frame_.light.sky = even_sky(0.6F);
  set_sun(40, 25, 2);
  request_.T_world_camera = look({0, -5, 2}, {0, 0, 0});
  request_.switches.shadows = false;
  frame_.surface.wetness = 0.8F;
  expect_alike("wet", 0.5, 0.01, 3e-3, 1);
  frame_.surface = {0, 0.03F};
  expect_alike("snow", 0.5, 0.02, 3e-3, 1);
}

TEST_F(LightAgainstView, WaterAndPolishedThings) {
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 16;
  for (int j = 0; j < 16; ++j)
    for (int i = 0; i < 64; ++i) sky->radiance.push_back(grey(1 + 0.06F * static_cast<float>(j)));
  frame_.light.sky = sky;
  auto water = SurfaceOf::grey(0.02F);
  water->water = true;
  water->roughness = 0.05F;
  auto varnished = SurfaceOf::grey(0.2F);
  varnished->roughness = 0.3F;
  auto metal = SurfaceOf::grey(0.7F);
  metal->roughness = 0.2F;
  metal->metallic = 1;
  set_sun(10, 45, 2);
  request_.switches.shadows = false;
  request_.T_world_camera = look({0, -6, 3}, {0, 0, 0});
  for (const auto& [name, surface] :
       {std::pair{"water", water}, std::pair{"varnished", varnished}, std::pair{"metal", metal}}) {
    frame_.batches = {one(plane_mesh(4, surface), 1)};
    expect_alike(name, 0.6, 0.03, 6e-3, 1);
  }
}

TEST_F(LightAgainstView, SkyAndSun) {
  auto sky = std::make_shared<SkyMap>();
  sky->width = 64;
  sky->height = 16;
  for (int j = 0; j < 16; ++j)
    for (int i = 0; i < 64; ++i)
      sky->radiance.push_back(grey(2 - 0.06F * static_cast<float>(j) +
                                   0.3F * static_cast<float>(std::sin(i * 2 * std::numbers::pi / 64))));
  frame_.light.sky = sky;
  frame_.light.ground_albedo = grey(0.3F);
  request_.T_world_camera = look({0, 0, 2}, Eigen::Vector3d(0, 0, 2) + direction(350, 5));
  expect_alike("sky", 2, 4e-3, 1e-3, 1);
}

}  // namespace
}  // namespace rigor::test
