#include <numeric>

#include "sim/world/pose.h"
#include "tests/sim/render/range_view/range_fixture.h"

namespace rigor::test {
namespace {

class RangeView : public RangeViewTest {};

std::shared_ptr<Batch> turned(std::shared_ptr<Batch> b, const Eigen::Quaterniond& q) {
  for (int i = 0; i < 3; ++i) b->instances[0].rotation[i] = static_cast<float>(q.coeffs()[i]);
  b->instances[0].rotation[3] = static_cast<float>(q.w());
  return b;
}

/// A room's walls and floor about the eye, facing inwards: half sizes 5, 6 and 2 m.
std::shared_ptr<Mesh> room_mesh(std::shared_ptr<const Surface> s) {
  Mesh m;
  add_box(m, {5, 6, 2});
  for (std::size_t i = 0; i < m.indices.size(); i += 3) std::swap(m.indices[i], m.indices[i + 1]);
  for (Vertex& v : m.vertices)
    for (float& c : v.normal) c = -c;
  return finished(std::move(m), std::move(s));
}

// A wall square to the view, one at a slant and the ground at 2 m out to 1.1 degrees of grazing: range =
// distance / cosine. Errors: of floats in the device's interpolation, 25 to 200 um in views of this kind; the
// bound is 0.2 mm + 20 ppm. Stair-stepping of the ground (range of the texel's middle) is 1000 times that.
TEST_F(RangeView, PlanesStandAtTheirRange) {
  const Eigen::Vector3d normals[] = {{0, -1, 0}, Eigen::Vector3d(0.6, -0.8, 0), Eigen::Vector3d(0, -0.1, 1)};
  const double distances[] = {10, 7, 2};
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d n = normals[k].normalized();
    show({turned(one(plane_mesh(400, SurfaceOf::grey(0.5F)), 9, -distances[k] * n),
                 rotation_between(Eigen::Vector3d::UnitZ(), n))});
    const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, 0}).linear(), 176, 144, 250);
    const auto hits = cast(rays);
    std::size_t met = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const double c = -direction_of(rays[i]).dot(n), expected = distances[k] / c;
      if (c < 0.02) continue;
      ++met;
      ASSERT_NEAR(hits[i].range_m, expected, 2e-4 + 2e-5 * expected) << i;
      EXPECT_EQ(hits[i].node.value, 9U);
      EXPECT_NEAR(hits[i].cos_incidence, c, 1e-5);
      EXPECT_NEAR(hits[i].reflectance, 0.5, 1e-6);
    }
    EXPECT_GT(met, 15000U);
  }
}

// Chords of the triangles lie inside the sphere by r (1 - cos(step / 2)) at most, seen at a slant of 1 /
// cosine.
TEST_F(RangeView, ASphereStandsAtItsRange) {
  constexpr int kSteps = 180;
  show({one(sphere_mesh(1, kSteps, SurfaceOf::grey(0.3F)), 4, {0, 5, 0})});
  const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, 0}).linear(), 120, 120, 240);
  const auto hits = cast(rays);
  const double sagitta = 1 - std::cos(std::numbers::pi / kSteps / 2 * std::numbers::sqrt2);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Eigen::Vector3d d = direction_of(rays[i]), centre(0, 5, 0);
    const double along = d.dot(centre), inside = 1 - (centre.squaredNorm() - along * along);
    if (inside < -0.02) {
      EXPECT_TRUE(hits[i].nothing()) << i;
      continue;
    }
    if (inside < 0.04) continue;  // 78 degrees of incidence
    const double range = along - std::sqrt(inside);
    const Eigen::Vector3d n = range * d - centre;
    // A ray takes the facet and the normal of its texel's middle, which may lie so far beside it on the
    // sphere.
    const double cosine = std::sqrt(inside), beside_m = 0.71 / 500 * range / cosine;
    ASSERT_NEAR(hits[i].range_m, range, 2e-4 + (2 * sagitta + std::numbers::pi / kSteps * beside_m) / cosine)
        << i;
    const Eigen::Vector3d normal = Eigen::Map<const Eigen::Vector3f>(hits[i].normal).cast<double>();
    EXPECT_NEAR((normal - n).norm(), 0, 1e-3 + beside_m);
    EXPECT_NEAR(hits[i].cos_incidence, cosine, 1e-3 + beside_m) << i;
  }
}

TEST_F(RangeView, WhatIsSeenHasItsNodeAndItsSurface) {
  auto left = SurfaceOf::grey(0.2F), right = SurfaceOf::grey(0.6F);
  left->retro_reflection = 0.5F;
  right->water = true;
  auto three = batch_of(prototype_of(box_mesh({0.5F, 0.5F, 0.5F}, right)), {at(1, 10, 0), at(3, 10, 0)});
  three->nodes = {NodeId{21}, NodeId{(std::uint64_t{3} << 40) + 22}};
  show({one(box_mesh({0.5F, 0.5F, 0.5F}, left), 20, {-1, 10, 0}), three});
  const auto hits = cast({ray({-1, 10, 0}), ray({1, 10, 0}), ray({3, 10, 0}), ray({5, 10, 0})});
  EXPECT_EQ(hits[0].node.value, 20U);
  EXPECT_EQ(hits[0].surface, left.get());
  EXPECT_EQ(hits[0].retro_reflection, 0.5F);
  EXPECT_FALSE(hits[0].water);
  EXPECT_EQ(hits[1].node.value, 21U);
  EXPECT_EQ(hits[1].surface, right.get());
  EXPECT_TRUE(hits[1].water);
  EXPECT_EQ(hits[2].node.value, (std::uint64_t{3} << 40) + 22);
  EXPECT_TRUE(hits[3].nothing());
  EXPECT_EQ(hits[3].surface, nullptr);
}

TEST_F(RangeView, RaysGoThroughHoles) {
  auto leaf = SurfaceOf::grey(0.8F);
  auto map = std::make_shared<Texture>();
  map->width = map->height = 2;
  map->srgb = map->repeat = false;
  for (int i = 0; i < 4; ++i)
    for (const int c : {255, 128, 0, i % 2 == 0 ? 255 : 0}) map->rgba.push_back(static_cast<std::uint8_t>(c));
  leaf->colour_map = map;
  leaf->alpha_cutoff = 0.5F;
  leaf->two_sided = true;
  leaf->transmittance = grey(0.25F);
  const auto upright = Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX()));
  // Seen from behind: the left half of the map, which is there, stands on the left.
  show({turned(one(plane_mesh(1, leaf), 1, {0, 5, 0}), upright),
        turned(one(plane_mesh(9, SurfaceOf::grey(0.5F)), 2, {0, 8, 0}), upright)});
  const auto hits = cast({ray({-0.7, 5, 0.2}), ray({0.7, 5, 0.2})}, 1);
  EXPECT_EQ(hits[0].node.value, 1U);
  EXPECT_NEAR(hits[0].reflectance, 0.8 * 128 / 255, 1e-4);
  EXPECT_NEAR(hits[0].transmittance, 0.25 * 128 / 255, 1e-4);
  EXPECT_EQ(hits[1].node.value, 2U);
  EXPECT_NEAR(hits[1].range_m, 8 * std::sqrt(1 + 0.0196 + 0.0016), 3e-4);
}

TEST_F(RangeView, BandsTintAndMapsByHand) {
  auto s = std::make_shared<Surface>();
  s->reflectance = {0.9F, 0.8F, 0.7F, 0.6F, 0.5F, 0.4F};
  s->roughness = 0.8F;
  const auto even = [](int r, int g, int b) {
    auto t = std::make_shared<Texture>();
    t->width = t->height = 1;
    t->srgb = false;
    for (const int c : {r, g, b, 255}) t->rgba.push_back(static_cast<std::uint8_t>(c));
    return t;
  };
  s->colour_map = even(51, 102, 153);
  s->gloss_map = even(128, 0, 0);
  // A normal map that leans by atan(0.5) along growing u: east here.
  s->normal_map = even(128 + 57, 128, 128 + 114);
  auto wall = turned(one(plane_mesh(3, s), 1, {0, 5, 0}),
                     Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX())));
  wall->instances[0].tint[0] = 0.5F;
  show({wall});
  const double tint = (0.5 + 1 + 1) / 3, grey_map = (51 + 102 + 153) / 3.0 / 255;
  const double expected[] = {0.9 * 51 / 255 * 0.5, 0.8 * 102 / 255, 0.7 * 153 / 255};
  for (int band = 0; band < 6; ++band) {
    const auto hit = cast({ray({0.1, 5, 0.1})}, band).front();
    const double r = band < 3 ? expected[band] : static_cast<double>(s->reflectance[band]) * grey_map * tint;
    EXPECT_NEAR(hit.reflectance, r, 1e-5) << band;
    EXPECT_NEAR(hit.roughness, 0.8 * (1 - 0.95 * 128 / 255), 1e-5);
    EXPECT_NEAR(hit.uv[0], 0.5 + 0.1 / 6, 1e-5);
    EXPECT_NEAR(hit.uv[1], 0.5 - 0.1 / 6, 1e-5);
    // One step of a map's eight bits is 8 mrad.
    EXPECT_NEAR(hit.normal[0], 1 / std::sqrt(5.0), 8e-3);
    EXPECT_NEAR(hit.normal[1], -2 / std::sqrt(5.0), 8e-3);
    EXPECT_NEAR(hit.normal[2], 0, 8e-3);
  }
  s = std::make_shared<Surface>(*s);
  s->serial = next_serial();
  s->near_infrared_map = even(255, 51, 0);
  show({turned(one(plane_mesh(3, s), 1, {0, 5, 0}),
               Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX())))});
  EXPECT_NEAR(cast({ray({0, 5, 0})}, 4).front().reflectance, 0.5 * 51 / 255, 1e-5);
  EXPECT_NEAR(cast({ray({0, 5, 0})}, 0).front().reflectance, 0.9 * 51 / 255, 1e-5);
}

/// Range to the walls of `room_mesh`.
double room_range(const Eigen::Vector3d& d) {
  return std::min({5 / std::abs(d.x()), 6 / std::abs(d.y()), 2 / std::abs(d.z())});
}

TEST_F(RangeView, AllRoundWithoutSeams) {
  show({one(room_mesh(SurfaceOf::grey(0.4F)), 3)});
  for (const double tilt : {0.0, 0.4}) {
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(tilt, Eigen::Vector3d(1, 0.3, 0).normalized()).matrix();
    auto rays = ring_rays(1441, 16, -15, 15);
    for (const double up : {-89.9, -60.0, -46.0, -44.0, 44.0, 46.0, 60.0, 89.9})
      for (const Ray& r : ring_rays(61, 1, up, up)) rays.push_back(r);
    for (Ray& r : rays) r = ray(turn * direction_of(r));
    const auto hits = cast(rays);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Eigen::Vector3d d = direction_of(rays[i]);
      // Where walls meet, a ray half a texel away may be given the other one's range.
      const double slack = std::abs(hits[i].range_m - room_range(d)) / room_range(d);
      ASSERT_LT(slack, 0.5 / 500 * 3.5) << d.transpose();
      Eigen::Array3d walls = (d.array().abs() / Eigen::Array3d(5, 6, 2));
      std::sort(walls.begin(), walls.end());
      if (walls[2] > walls[1] * 1.01) {
        ASSERT_NEAR(hits[i].range_m, room_range(d), 2e-4) << d.transpose();
      }
    }
  }
}

TEST_F(RangeView, ARayTakesTheNearestInstant) {
  auto window = std::make_shared<ContentWindow>();
  const auto wall = plane_mesh(20, SurfaceOf::grey(0.5F));
  const auto q = Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX()));
  const auto proto = prototype_of(wall);
  for (int i = 0; i < 4; ++i) {
    auto f = std::make_shared<ContentFrame>();
    f->batches = {turned(batch_of(proto, {at(0, 0, 0)}, 1, {0, 10.0 + i, 0}), q)};
    window->frames.push_back(f);
  }
  window->end = window->begin + Duration(3'000'000);
  engine_->set_options({.instants = 4});
  show(window);
  std::vector<Ray> rays;
  for (const float t : {0.0F, 0.1F, 0.3F, 0.65F, 0.9F, 1.0F}) rays.push_back(ray({0, 1, 0}, t));
  const auto hits = cast(rays);
  const double expected[] = {10, 10, 11, 12, 13, 13};
  for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(hits[i].range_m, expected[i], 2e-4) << i;
}

TEST_F(RangeView, AsExactFarFromTheOrigin) {
  const Eigen::Vector3d there(1e5, -8e4, 500);
  show({one(room_mesh(SurfaceOf::grey(0.4F)), 3, there)});
  const auto rays = ring_rays(360, 4, -10, 10);
  const auto hits = cast(rays, 4, there + Eigen::Vector3d(0.25, 0, 0));
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Eigen::Vector3d d = direction_of(rays[i]);
    const double to_x = (d.x() > 0 ? 4.75 : 5.25) / std::abs(d.x()), to_y = 6 / std::abs(d.y());
    if (std::abs(to_x - to_y) < 0.05) continue;
    EXPECT_NEAR(hits[i].range_m, std::min({to_x, to_y, 2 / std::abs(d.z())}), 2e-4);
  }
}

TEST_F(RangeView, NearAndFarAreKept) {
  const auto q = Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitX()));
  const auto glass = plane_mesh(0.05F, SurfaceOf::grey(0.5F)), wall = plane_mesh(1000, SurfaceOf::grey(0.5F));
  show({turned(one(glass, 1, {0, 0.02, 0}), q), turned(one(wall, 2, {0, 9000, 0}), q)});
  std::vector<Ray> rays{ray({0.01, 1, 0}), ray({0.01, 1, 0})};
  rays[1].far_m = 0.019F;
  std::vector<Hit> hits(2);
  ASSERT_TRUE(engine_->cast({.near_m = 0.001F, .rays = rays}, hits));
  EXPECT_NEAR(hits[0].range_m, 0.02, 1e-5);
  EXPECT_TRUE(hits[1].nothing());
  ASSERT_TRUE(engine_->cast({.near_m = 0.1F, .rays = rays}, hits));
  EXPECT_EQ(hits[0].node.value, 2U);
  EXPECT_NEAR(hits[0].range_m, 9000 * std::sqrt(1.0001), 0.18);
}

TEST_F(RangeView, WhatCannotBeCastMeetsNothing) {
  std::vector<Ray> rays{ray({0, 1, 0}), ray({0, 1, 0}), ray({0, 1, 0}), ray({0, 1, 0})};
  rays[1].direction[0] = std::numeric_limits<float>::quiet_NaN();
  rays[2].origin[1] = std::numeric_limits<float>::infinity();
  rays[3].direction[1] = 3;
  std::vector<Hit> hits(4);
  EXPECT_FALSE(engine_->cast({.rays = rays}, hits)) << "nothing prepared";
  show(std::vector<std::shared_ptr<const Batch>>{});
  for (const Hit& h : cast(rays)) EXPECT_TRUE(h.nothing());
  show({one(room_mesh(nullptr), 3)});
  hits = cast(rays);
  EXPECT_NEAR(hits[0].range_m, 6, 2e-4);
  ASSERT_NE(hits[0].surface, nullptr);
  EXPECT_EQ(hits[0].surface->name, "unknown");
  for (std::size_t i = 1; i < 4; ++i) EXPECT_TRUE(hits[i].nothing()) << i;
  EXPECT_TRUE(engine_->cast({}, {}));
  EXPECT_FALSE(engine_->cast({.rays = rays}, {}));
  EXPECT_FALSE(engine_->cast({.band = 6, .rays = rays}, hits));
  EXPECT_FALSE(engine_->cast({.near_m = -1, .rays = rays}, hits));
  EXPECT_FALSE(engine_->prepare(nullptr));
}

TEST_F(RangeView, ViewsLargerThanTheDeviceTakesArePieces) {
  engine_->set_options({.pixels_per_rad = 4000});
  show({one(room_mesh(SurfaceOf::grey(0.4F)), 3)});
  const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, 0}).linear(), 61, 41, 45);
  const auto hits = cast(rays);
  for (std::size_t i = 0; i < rays.size(); ++i)
    ASSERT_NEAR(hits[i].range_m, room_range(direction_of(rays[i])), 2e-3) << i;
}

// Bars a third of a pixel wide: seen where, and only where, a ray meets one. With texels that are not in step
// with the camera's pixels (seen: half a texel off) a quarter of the rays are wrong.
TEST_F(RangeView, TexelsOfACameraLieOnItsPixels) {
  constexpr double kFocal = 211;
  engine_->set_options({.pixels_per_rad = kFocal});
  std::vector<Instance> bars;
  for (int i = -40; i <= 40; ++i) bars.push_back(at(0.061F * static_cast<float>(i), 5, 0));
  show({batch_of(prototype_of(box_mesh({0.004F, 0.001F, 3}, SurfaceOf::grey(0.5F))), bars, 7)});
  const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, 0}).linear(), 176, 144, kFocal);
  const auto hits = cast(rays);
  std::size_t seen = 0, wrong = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Eigen::Vector3d d = direction_of(rays[i]);
    const double x = 4.999 * d.x() / d.y();
    const double from_bar = std::abs(x - 0.061F * std::round(x / 0.061));
    const bool there = std::abs(x) < 2.46 && from_bar < 0.004;
    if (std::abs(from_bar - 0.004) < 2e-4) continue;  // its edge, or its side
    seen += there ? 1 : 0;
    wrong += there == hits[i].nothing() ? 1 : 0;
  }
  EXPECT_GT(seen, 2000U);
  EXPECT_LE(wrong, rays.size() / 1000);
}

TEST_F(RangeView, TheSameBytesAgainAndBesideAViewRenderer) {
  auto view = ViewRenderer::create(device_);
  ASSERT_TRUE(view);
  show({one(room_mesh(SurfaceOf::grey(0.4F)), 3),
        one(sphere_mesh(1, 24, SurfaceOf::grey(0.3F)), 4, {1, 3, 0})});
  const auto rays = ring_rays(720, 8, -20, 20);
  const auto first = cast(rays);
  frame_.light.sky = even_sky(1);
  ViewRequest request;
  request.pinhole = pinhole(64, 48, 50);
  ViewPicture p;
  ASSERT_TRUE((*view)->draw(frame_, request, p));
  cast(pinhole_rays(look({0, 0, 0}, {1, 0, 0}).linear(), 20, 20, 60), 2);
  const auto again = cast(rays);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    EXPECT_EQ(first[i].range_m, again[i].range_m);
    EXPECT_EQ(first[i].node.value, again[i].node.value);
    EXPECT_EQ(0, std::memcmp(first[i].normal, again[i].normal, sizeof first[i].normal));
    EXPECT_EQ(first[i].reflectance, again[i].reflectance);
  }
}

}  // namespace
}  // namespace rigor::test
