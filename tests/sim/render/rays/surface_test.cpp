// What a ray learns of a surface: maps, holes, tint, weather, each worked out by hand.
#include <array>

#include "tests/sim/render/rays/rays_fixture.h"

namespace rigor::test {
namespace {

std::shared_ptr<Texture> texture(std::uint32_t w, std::uint32_t h, bool srgb,
                                 std::vector<std::array<std::uint8_t, 4>> texels) {
  auto t = std::make_shared<Texture>();
  t->width = w;
  t->height = h;
  t->srgb = srgb;
  for (const auto& p : texels) t->rgba.insert(t->rgba.end(), p.begin(), p.end());
  return t;
}
/// IEC 61966-2-1.
double linear(int byte) {
  const double v = byte / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

TEST_F(RaysTest, ColourMapsAreDecodedBeforeTheyAreBlended) {
  auto s = surface_of(0.5F);
  s->reflectance = {0.5F, 0.6F, 0.7F, 0.8F, 0.4F, 0.3F};
  s->colour_map = texture(2, 1, true, {{200, 100, 50, 255}, {40, 220, 90, 255}});
  auto b = one(plane_mesh(1, s), 1);
  b->instances[0].tint[0] = 0.9F;
  b->instances[0].tint[1] = 0.6F;
  b->instances[0].tint[2] = 0.3F;
  show({b});
  // u = (x + 1) / 2; a quarter of the way from the first texel's middle (u = 1/4) to the second's is
  // u = 3/8: x = -1/4.
  const double share = 0.25, x = -0.25;
  const auto at = [&](int a, int c) { return (1 - share) * linear(a) + share * linear(c); };
  const double red = at(200, 40), green = at(100, 220), blue = at(50, 90);
  const double expected[6] = {0.5 * red * 0.9,
                              0.6 * green * 0.6,
                              0.7 * blue * 0.3,
                              0.8 * (red + green + blue) / 3 * 0.6,
                              0.4 * (red + green + blue) / 3 * 0.6,
                              0.3 * (red + green + blue) / 3 * 0.6};
  for (int band = 0; band < 6; ++band)
    EXPECT_NEAR(shoot({x, 0, 2}, {0, 0, -1}, 0, band).reflectance, expected[band], 1e-5) << band;
}

TEST_F(RaysTest, ANearInfraredMapCountsForTheNearInfraredAlone) {
  auto s = surface_of(0.5F);
  s->transmittance = grey(0.25F);
  s->colour_map = texture(1, 1, true, {{128, 128, 128, 255}});
  s->near_infrared_map = texture(1, 1, false, {{51, 102, 204, 255}});
  s->gloss_map = texture(1, 1, false, {{102, 0, 0, 255}});
  s->roughness = 0.8F;
  s->metallic = 0.25F;
  s->retro_reflection = 0.5F;
  show({one(plane_mesh(1, s), 1)});
  const auto in = [&](int band) { return shoot({0, 0, 2}, {0, 0, -1}, 0, band); };
  EXPECT_NEAR(in(0).reflectance, 0.5 * linear(128), 1e-6);
  EXPECT_NEAR(in(3).reflectance, 0.5 * 0.2, 1e-6);
  EXPECT_NEAR(in(4).reflectance, 0.5 * 0.4, 1e-6);
  EXPECT_NEAR(in(5).reflectance, 0.5 * 0.8, 1e-6);
  EXPECT_NEAR(in(5).transmittance, 0.25 * 0.8, 1e-6);
  EXPECT_NEAR(in(4).roughness, 0.8 * (1 - 0.95 * 0.4), 1e-6);
  EXPECT_FLOAT_EQ(in(4).metallic, 0.25F);
  EXPECT_FLOAT_EQ(in(4).retro_reflection, 0.5F);
  EXPECT_EQ(in(4).surface, s.get());
}

TEST_F(RaysTest, ANormalMapTurnsTheNormalTowardsGrowingUAndThePicturesTop) {
  // (0.6, 0, 0.8) and (0, 0.6, 0.8) as bytes.
  for (const bool up : {false, true}) {
    auto s = surface_of(0.5F);
    s->two_sided = true;
    s->normal_map =
        up ? texture(1, 1, false, {{128, 204, 230, 255}}) : texture(1, 1, false, {{204, 128, 230, 255}});
    auto b = one(plane_mesh(1, s), 1);
    // Turned about z by a right angle: u grows to the north, the picture's top points west.
    turn(b->instances[0], Eigen::Quaternionf(Eigen::AngleAxisf(1.57079633F, Vector3f::UnitZ())));
    show({b});
    const Hit h = shoot({0.1, 0.2, 2}, {0, 0, -1});
    const Vector3f n = normal_of(h), wanted = up ? Vector3f(-0.6F, 0, 0.8F) : Vector3f(0, 0.6F, 0.8F);
    EXPECT_LT((n - wanted).norm(), 0.01F) << n.transpose();
    EXPECT_NEAR(h.cos_incidence, 0.8, 0.005);
    // From a slant that looks along the bump the cosine is 1.
    const Vector3d along = -wanted.cast<double>();
    EXPECT_NEAR(shoot(-2 * along, along).cos_incidence, 1.0, 1e-3);
    // From behind the bump is the same relief on the other side.
    const Vector3f below = normal_of(shoot({0.1, 0.2, -2}, {0, 0, 1}));
    EXPECT_LT((below - Vector3f(wanted.x(), wanted.y(), -0.8F)).norm(), 0.01F) << below.transpose();
  }
}

TEST_F(RaysTest, NormalsOfUnevenlyScaledThingsStandOnTheirSurfaces) {
  // A plane through (1, 1) of a box that is stretched: the normal goes with the inverse transpose.
  Mesh m;
  add_quad(m, {-1, -1, -1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, -1});
  auto b = one(finished(std::move(m), surface_of(0.5F)), 1);
  b->instances[0].scale[0] = 3;
  b->instances[0].scale[1] = 2;
  show({b});
  const Vector3f n = normal_of(shoot({0, 0, 5}, {0, 0, -1}));
  EXPECT_LT((n - Vector3f(-1, 0, 3).normalized()).norm(), 1e-6F) << n.transpose();
}

TEST_F(RaysTest, RaysGoThroughHolesAndStopBesideThem) {
  // A hole in the middle of 8 x 8 texels: 2 x 2. At a texel's edge, half covered, the cutoff of 0.5 stops.
  std::vector<std::array<std::uint8_t, 4>> texels(64, {90, 120, 60, 255});
  for (const int i : {27, 28, 35, 36}) texels[static_cast<std::size_t>(i)][3] = 0;
  auto s = surface_of(0.3F);
  s->colour_map = texture(8, 8, true, texels);
  s->alpha_cutoff = 0.5F;
  show({one(plane_mesh(1, s), 1), one(plane_mesh(5, surface_of(0.7F), -1), 2)});
  EXPECT_EQ(shoot({0, 0, 2}, {0, 0, -1}).node.value, 2U);
  EXPECT_EQ(shoot({0.5, 0, 2}, {0, 0, -1}).node.value, 1U);
  // Coverage crosses the cutoff on the hole's edge, where x = 1/4.
  EXPECT_EQ(shoot({0.245, 0, 2}, {0, 0, -1}).node.value, 2U);
  EXPECT_EQ(shoot({0.255, 0, 2}, {0, 0, -1}).node.value, 1U);
  std::vector<std::uint8_t> hidden(2);
  const std::vector<Ray> rays{[&] {
                                Ray r = ray_of({0, 0, 2}, {0, 0, -1});
                                r.far_m = 2.5F;
                                return r;
                              }(),
                              [&] {
                                Ray r = ray_of({0.5, 0, 2}, {0, 0, -1});
                                r.far_m = 2.5F;
                                return r;
                              }()};
  ASSERT_TRUE(engine_->occluded({.rays = rays}, hidden));
  EXPECT_EQ(hidden, (std::vector<std::uint8_t>{0, 1}));
}

TEST_F(RaysTest, MapsWithoutTexelsAndSurfacesThatAreNoneDoNoHarm) {
  auto s = surface_of(0.6F);
  s->colour_map = std::make_shared<Texture>();
  s->normal_map = s->gloss_map = s->near_infrared_map = s->colour_map;
  s->alpha_cutoff = 0.5F;
  show({one(plane_mesh(1, s), 1), one(plane_mesh(9, nullptr, -1), 2)});
  EXPECT_FLOAT_EQ(shoot({0, 0, 2}, {0, 0, -1}).reflectance, 0.6F);
  EXPECT_EQ(shoot({0, 0, 2}, {0, 0, -1}).node.value, 1U);
  const Hit none = shoot({3, 0, 2}, {0, 0, -1});
  EXPECT_FLOAT_EQ(none.reflectance, 0.5F);
  ASSERT_NE(none.surface, nullptr);
  EXPECT_EQ(none.surface->name, "unknown");
}

TEST_F(RaysTest, WaterDarkensSoilAndDeepSnowWhitensWhatFacesUp) {
  auto s = surface_of(0.4F);
  s->porosity = 0.8F;
  ContentFrame f;
  f.batches = {one(plane_mesh(5, s), 1)};
  f.surface.wetness = 0.5F;
  show(window_of(std::vector<ContentFrame>{f}));
  EXPECT_NEAR(shoot({0, 0, 2}, {0, 0, -1}).reflectance, 0.4 * (1 - 0.55 * 0.5 * 0.8), 1e-6);
  // 0.5 m: level ground is covered whatever the pattern (slope at least 0.75, full from 0.5 on).
  f.surface = {0, 0.5F};
  show(window_of(std::vector<ContentFrame>{f}));
  EXPECT_NEAR(shoot({0.3, 0.1, 2}, {0, 0, -1}, 0, 4).reflectance, 0.83, 1e-6);
  EXPECT_NEAR(shoot({0.3, 0.1, 2}, {0, 0, -1}, 0, 5).reflectance, 0.12, 1e-6);
}

}  // namespace
}  // namespace rigor::test
