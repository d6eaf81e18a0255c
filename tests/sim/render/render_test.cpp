// The sensor side of the cameras of small scenes: lens and sensor against the same models in double, formats,
// and what they refuse.
#include <cmath>
#include <thread>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"
#include "sim/render/device.h"
#include "tests/sim/render/render_fixture.h"

namespace rigor {
namespace {

using Rendering = test::RenderTest;

OpenCvLens barrel() { return {.k1 = -0.28, .k2 = 0.09, .p1 = 0.0012, .p2 = -0.0007}; }

world::Scene busy_scene(world::Scene s) {
  s.ground->other_material = 2;
  s.ground->noise_contrast = 0.4;
  world::Body b{.name = "box", .size_m = {1, 1, 1}, .material = 1};
  b.T_node_body.translate(Eigen::Vector3d(0, 0, 0.5));
  s.bodies = {b};
  return s;
}

// The lens map (float) against the double model: 1e-6 in the ray is 3e-4 px here.
TEST_F(Rendering, RaysOfTheLensFollowTheModelInDouble) {
  CameraSpec c = spec();
  c.model.lens = barrel();
  auto camera = make(c, plain_scene());
  ASSERT_TRUE(camera);
  const auto rays = camera->renderer().rays();
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 320; ++u) {
      const auto ray = unproject(c.model, {static_cast<double>(u), static_cast<double>(v)});
      const auto& m = rays[static_cast<std::size_t>(v * 320 + u)];
      ASSERT_TRUE(ray);
      ASSERT_NEAR(m[0], ray->x, 1e-6);
      ASSERT_NEAR(m[1], ray->y, 1e-6);
    }
}

// A lens that folds leaves the corners without light: dark current's mean is all that they collect.
TEST_F(Rendering, PixelsThatTheLensDoesNotImageStayDark) {
  CameraSpec c = spec();
  c.model.lens = {.k1 = -1.2};
  c.model.noise.black_level_dn = 100;
  c.model.noise.dark_current_e_per_s = 0;
  auto camera = make(c, plain_scene());
  ASSERT_TRUE(camera);
  ASSERT_FALSE(unproject(c.model, {0, 0})) << "the case must have such pixels";
  const auto pixels = shoot(*camera);
  EXPECT_EQ(at16(pixels, 320, 0, 0), 100);
  EXPECT_EQ(at16(pixels, 320, 319, 239), 100);
  EXPECT_GT(at16(pixels, 320, 160, 200), 200);
}

// The whole way from the light to the digital number, over again in double with the same draws. The float's
// mean errs by 1e-6 of itself, so a step of Poisson or rounding may fall the other way: at most one DN per
// electron step K, and seldom.
TEST_F(Rendering, SensorFollowsTheModelInDouble) {
  CameraSpec c = spec();
  c.model.lens = barrel();
  c.model.vignetting.cos4_weight = 1;
  c.noise = true;
  c.seed = 42;
  c.T_parent_sensor = look_at({3, -4, 2}, {0, 0, 0.3});
  auto camera = make(c, busy_scene(plain_scene()));
  ASSERT_TRUE(camera);
  const world::WorldSnapshot w(camera->scene());
  render::PictureRequest q;
  q.T_world_sensor = c.T_parent_sensor;
  q.region = {0, 0, 320, 240};
  std::vector<float> rates(320 * 240);
  ASSERT_TRUE(camera->renderer().draw(q, w, rates));
  const auto key = models::channel_key(42, models::channel_id_from_name("camera"));
  const EmvaNoise& n = c.model.noise;
  using N = models::NoiseMath<double>;
  using L = models::LensMath<double>;
  for (const double exposure_s : {0.0005, 0.004}) {  // few electrons (search) and many (expansion)
    const auto pixels =
        shoot(*camera, {.capture_index = 5, .exposure = seconds_from(exposure_s), .gain_db = 6.0}, w);
    int different = 0;
    double sum = 0;
    for (std::uint32_t i = 0; i < 320 * 240; ++i) {
      const auto ray = unproject(c.model, {i % 320 * 1.0, i / 320 * 1.0});
      const auto pattern = models::draw_words(key, models::NoiseEffect::camera_fixed_pattern, 0, i);
      const double gain = L::vignetting_factor(ray->x, ray->y, 1, 0, 0, 0) *
                          std::max(0.0, 1 + n.prnu * N::normal_quantile(N::unit_from_bits(pattern[0])));
      const double offset = n.dsnu_e * N::normal_quantile(N::unit_from_bits(pattern[1]));
      const auto words = models::draw_words(key, models::NoiseEffect::camera_shot_and_read, 5, i);
      const double mean = N::emva_mean_electrons(double{rates[i]}, n.dark_current_e_per_s, gain, exposure_s);
      const double e = N::emva_collected_electrons(N::poisson_quantile(mean, N::unit_from_bits(words[0])),
                                                   n.full_well_e, offset, n.read_noise_e,
                                                   N::normal_quantile(N::unit_from_bits(words[1])));
      const double k = c.model.system_gain_dn_per_e() * std::pow(10.0, 6.0 / 20.0);
      const double dn = N::emva_quantise(N::emva_analogue_dn(e, k, n.black_level_dn), 4095);
      const double got = at16(pixels, 320, static_cast<int>(i % 320), static_cast<int>(i / 320));
      sum += dn;
      if (got != dn) ++different;
      ASSERT_NEAR(got, dn, 4) << i;
    }
    EXPECT_GT(sum / (320 * 240), 20) << "the comparison must not be one of black pictures";
    EXPECT_LT(different, 320 * 240 / 50);
  }
}

TEST_F(Rendering, SameRequestSameBytesFromAnyThreadAndOtherNoiseInAnotherCapture) {
  CameraSpec c = spec();
  c.noise = true;
  c.model.lens = barrel();
  c.T_parent_sensor = look_at({3, -4, 2}, {0, 0, 0.3});
  auto camera = make(c, busy_scene(plain_scene()));
  auto same = make(c, busy_scene(plain_scene()));
  ASSERT_TRUE(camera && same);
  const auto first = shoot(*camera, {.capture_index = 1});
  const auto second = shoot(*camera, {.capture_index = 2});
  EXPECT_NE(first, second);
  EXPECT_EQ(shoot(*camera, {.capture_index = 1}), first) << "whatever was drawn in between";
  std::vector<std::byte> a, b;
  std::thread t1([&] { a = shoot(*camera, {.capture_index = 1}); });
  std::thread t2([&] { b = shoot(*same, {.capture_index = 1}); });
  t1.join();
  t2.join();
  EXPECT_EQ(a, first);
  EXPECT_EQ(b, first);
  c.seed = 1;
  auto other_seed = make(c, busy_scene(plain_scene()));
  ASSERT_TRUE(other_seed);
  EXPECT_NE(shoot(*other_seed, {.capture_index = 1}), first);
}

// The optical path is one: every format of one camera shows the same numbers in its own packing.
TEST_F(Rendering, FormatsPackTheSameNumbers) {
  CameraSpec c = spec();
  c.T_parent_sensor = look_at({3, -4, 2}, {0, 0, 0.3});
  // All three filters alike, so that mono and colour see the same light.
  for (auto& row : c.model.optics.colour_efficiency) row = c.model.optics.mono_efficiency;
  c.model.width_px = 317;  // no multiple of what is worked out at a time
  const world::Scene s = busy_scene(plain_scene());
  const CaptureRequest q{.exposure = microseconds(700)};
  auto camera16 = make(c, s);
  ASSERT_TRUE(camera16);
  const auto p16 = shoot(*camera16, q);
  const auto with = [&](PixelFormat f) {
    CameraSpec other = c;
    other.format = f;
    auto camera = make(other, s);
    return camera ? shoot(*camera, q) : std::vector<std::byte>{};
  };
  const auto p8 = with(PixelFormat::mono8), p12 = with(PixelFormat::mono12p),
             bayer = with(PixelFormat::bayer_rg8), rgb = with(PixelFormat::rgb8),
             p10 = with(PixelFormat::mono10), p12w = with(PixelFormat::mono12),
             b10 = with(PixelFormat::bayer_rg10);
  const std::size_t n = 317 * 240;
  ASSERT_EQ(p12.size(), (n * 12 + 7) / 8);
  ASSERT_EQ(rgb.size(), 3 * n);
  double mean = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const int dn = at16(p16, static_cast<int>(n), static_cast<int>(i), 0);
    mean += dn;
    const std::size_t byte = i * 12 / 8;
    const int lo = std::to_integer<int>(p12[byte]), hi = std::to_integer<int>(p12[byte + 1]);
    ASSERT_EQ(i % 2 == 0 ? lo | (hi & 15) << 8 : lo >> 4 | hi << 4, dn) << i;
    ASSERT_EQ(std::to_integer<int>(p8[i]), dn >> 4) << i;
    ASSERT_NEAR(std::to_integer<int>(bayer[i]), dn >> 4, 1);
    ASSERT_EQ(at16(p10, static_cast<int>(n), static_cast<int>(i), 0), dn >> 2);
    ASSERT_EQ(at16(p12w, static_cast<int>(n), static_cast<int>(i), 0), dn);
    ASSERT_NEAR(at16(b10, static_cast<int>(n), static_cast<int>(i), 0), dn >> 2, 1);
    for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(std::to_integer<int>(rgb[3 * i + k]), dn >> 4, 1);
  }
  EXPECT_GT(mean / static_cast<double>(n), 100);
}

TEST_F(Rendering, BayerSitesSeeTheirOwnColour) {
  world::Scene s = plain_scene();
  s.materials[0].reflectance = {0.6, 0.3, 0.1, 0};
  CameraSpec c = spec();
  c.format = PixelFormat::bayer_rg8;
  for (std::size_t f = 0; f < 3; ++f) {
    c.model.optics.colour_efficiency[f] = {};
    c.model.optics.colour_efficiency[f][f] = 0.5;
  }
  c.T_parent_sensor = look_at({0, 0, 3}, {0, 0.001, 0});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const auto p = shoot(*camera, {.exposure = milliseconds(5), .region = {100, 60, 16, 8}});
  const int r = std::to_integer<int>(p[0]), g1 = std::to_integer<int>(p[1]), g2 = std::to_integer<int>(p[16]),
            b = std::to_integer<int>(p[17]);
  EXPECT_GT(r, g1 * 3 / 2);
  EXPECT_NEAR(g1, g2, 1);
  EXPECT_GT(g1, 2 * b);
  EXPECT_GT(b, 0);
}

TEST_F(Rendering, RefusesWhatItCannotDraw) {
  CameraSpec c = spec();
  c.format = PixelFormat::bayer_rg8;
  auto camera = make(c, plain_scene());
  ASSERT_TRUE(camera);
  const world::WorldSnapshot w(camera->scene());
  std::vector<std::byte> pixels(camera->full_region_bytes());
  const auto refused = [&](const CaptureRequest& q, const char* said) {
    const Status s = camera->capture(q, w, pixels);
    ASSERT_FALSE(s) << said;
    EXPECT_EQ(s.error().code, ErrorCode::bad_input);
    EXPECT_NE(s.error().text().find(said), std::string::npos) << s.error().text();
  };
  refused({.region = {1, 0, 100, 100}}, "even");
  refused({.region = {300, 0, 100, 100}}, "320x240");
  refused({.region = {2147483646, 0, 100, 100}}, "320x240");
  refused({.region = {0, -2, 100, 100}}, "320x240");
  refused({.region = {0, 0, 100, 100}}, "10000 bytes");
  refused({.exposure = milliseconds(-1)}, "exposure");
  refused({.gain_db = 1e9}, "gain");
  EXPECT_FALSE(camera->capture({}, world::WorldSnapshot(*[] {
                                 static world::Scene other;
                                 other.nodes.resize(3);
                                 return &other;
                               }()),
                               pixels));

  const auto creation = [&](const CameraSpec& bad, const char* said) {
    auto made = CameraSimulator::create(bad, std::make_shared<const world::Scene>(plain_scene()));
    ASSERT_FALSE(made) << said;
    EXPECT_EQ(made.error().code, ErrorCode::bad_input);
    EXPECT_NE(made.error().text().find(said), std::string::npos) << made.error().text();
  };
  c = spec();
  c.parent_node = "nobody";
  creation(c, "nobody");
  c = spec();
  c.model.bloom.fraction = 0.1;
  creation(c, "bloom");
  c = spec();
  c.model.lens = {.k1 = -1e9};
  c.model.cx_px = -1000;
  creation(c, "lens");
  c = spec();
  c.model.projection = Projection::kannala_brandt;
  creation(c, "fisheye");
}

TEST(Device, NamesWhatIsThereWhenTheWantedOneIsNot) {
  const auto names = render::Device::list();
  if (!names || names->empty()) GTEST_SKIP() << "no Vulkan device";
  const auto device = render::Device::create({.name_contains = "no such device"});
  ASSERT_FALSE(device);
  EXPECT_EQ(device.error().code, ErrorCode::unavailable);
  EXPECT_NE(device.error().text().find((*names)[0]), std::string::npos);
}

}  // namespace
}  // namespace rigor
