// The engine of range views against the engine of rays, in one and the same content.
#include "sim/render/rays/embree_engine.h"
#include "tests/sim/render/range_view/range_fixture.h"

namespace rigor::test {
namespace {

class EnginesAgree : public RangeViewTest {
 protected:
  void SetUp() override {
    RangeViewTest::SetUp();
    if (!device_) return;
    auto cache = EmbreeCache::create();
    ASSERT_TRUE(cache) << cache.error().text();
    auto made = EmbreeEngine::create(*cache);
    ASSERT_TRUE(made) << made.error().text();
    rays_engine_ = *made;
  }
  std::vector<Hit> reference(const std::vector<Ray>& rays, const Eigen::Vector3d& origin) {
    EXPECT_TRUE(rays_engine_->prepare(still(frame_)));
    std::vector<Hit> hits(rays.size());
    EXPECT_TRUE(rays_engine_->cast({.origin = origin, .band = 4, .rays = rays}, hits));
    return hits;
  }
  std::shared_ptr<EmbreeEngine> rays_engine_;
};

/// A street of boxes on the ground, and one wall of bricks with colour, gloss and normal maps.
std::vector<std::shared_ptr<const Batch>> boxes() {
  auto bricks = SurfaceOf::grey(0.7F);
  bricks->roughness = 0.9F;
  auto colour = std::make_shared<Texture>(), normal = std::make_shared<Texture>();
  for (auto& t : {colour, normal}) {
    t->width = t->height = 8;
    t->srgb = t == colour;
  }
  for (int j = 0; j < 8; ++j)
    for (int i = 0; i < 8; ++i) {
      for (const int c : {60 + 20 * i, 200 - 15 * j, 90 + 9 * (i ^ j), 255})
        colour->rgba.push_back(static_cast<std::uint8_t>(c));
      for (const int c : {128 + 40 - 10 * i, 128 - 30 + 8 * j, 235, 255})
        normal->rgba.push_back(static_cast<std::uint8_t>(c));
    }
  bricks->colour_map = colour;
  bricks->normal_map = normal;
  bricks->gloss_map = colour;
  std::vector<Instance> street;
  for (int i = 0; i < 12; ++i) {
    auto b = at(static_cast<float>(i % 2 == 0 ? -6 : 7), static_cast<float>(4 * i),
                0.5F * static_cast<float>(i % 3));
    const double a = 0.3 * i;
    b.rotation[2] = static_cast<float>(std::sin(a / 2));
    b.rotation[3] = static_cast<float>(std::cos(a / 2));
    b.scale[2] = 1 + 0.2F * static_cast<float>(i % 4);
    b.tint[1] = 0.8F;
    street.push_back(b);
  }
  auto houses = batch_of(prototype_of(box_mesh({1.5F, 1, 2}, bricks)), street);
  for (std::uint64_t i = 0; i < 12; ++i) houses->nodes.push_back(NodeId{100 + i});
  return {one(plane_mesh(60, SurfaceOf::grey(0.25F)), 1, {0, 0, -1.5}), houses};
}

// Away from silhouettes: no other node or face among the rays round it. Tolerance of range: floats on both
// sides, 0.2 mm + 20 ppm (see range_view_test.cpp). Maps are read at the texel's middle and not at the ray,
// 0.71 of a texel of the view beside it at most; the bricks' normal changes by up to 2 rad a metre, where the
// map repeats.
TEST_F(EnginesAgree, OnBoxesAwayFromSilhouettes) {
  const Eigen::Vector3d origin(0, -6, 0.3);
  frame_.batches = boxes();
  show(still(frame_));
  const int w = 220, h = 120;
  const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, -0.05}).linear(), w, h, 200);
  const auto raster = cast(rays, 4, origin), exact = reference(rays, origin);
  std::size_t compared = 0, far_off = 0, wrong_node = 0, dim = 0, tilted = 0;
  const auto at_pixel = [&](int u, int v) -> const Hit& {
    return exact[static_cast<std::size_t>(v * w + u)];
  };
  double square = 0;
  for (int v = 1; v + 1 < h; ++v)
    for (int u = 1; u + 1 < w; ++u) {
      const std::size_t i = static_cast<std::size_t>(v * w + u);
      const Hit &a = raster[i], &b = exact[i];
      bool edge = false;
      for (int k = 0; k < 9; ++k) {
        const Hit& c = at_pixel(u + k % 3 - 1, v + k / 3 - 1);
        edge = edge || c.node != b.node || c.nothing() != b.nothing() ||
               (std::abs(c.uv[0] - b.uv[0]) > 0.3F || std::abs(c.uv[1] - b.uv[1]) > 0.3F);
      }
      if (edge) continue;
      ++compared;
      wrong_node += a.node != b.node || a.nothing() != b.nothing() || a.surface != b.surface ? 1 : 0;
      if (a.nothing() || b.nothing()) continue;
      const double error = static_cast<double>(a.range_m) - static_cast<double>(b.range_m);
      square += error * error;
      far_off += std::abs(error) > 2e-4 + 2e-5 * static_cast<double>(b.range_m) ? 1 : 0;
      dim += std::abs(a.reflectance - b.reflectance) > 0.01F || std::abs(a.roughness - b.roughness) > 0.02F;
      const double beside_m =
          0.71 / 500 * static_cast<double>(b.range_m) / std::max(0.01, static_cast<double>(b.cos_incidence));
      const double tilt = static_cast<double>((Eigen::Vector3f(a.normal) - Eigen::Vector3f(b.normal)).norm());
      tilted += tilt > 0.005 + 2 * beside_m ? 1 : 0;
    }
  std::printf(
      "%zu rays compared, RMS %.1f um; beyond tolerance: %zu range, %zu node, %zu material, %zu normal\n",
      compared, 1e6 * std::sqrt(square / static_cast<double>(compared)), far_off, wrong_node, dim, tilted);
  const std::size_t allowed = compared / 1000;
  EXPECT_GT(compared, 20000U);
  EXPECT_LE(far_off, allowed);
  EXPECT_LE(wrong_node, allowed);
  EXPECT_LE(dim, allowed);
  EXPECT_LE(tilted, allowed);
}

TEST_F(EnginesAgree, OnSnowAndWet) {
  const Eigen::Vector3d origin(512345.5, 4321.25, 103);
  frame_.batches.clear();
  for (const auto& b : boxes()) {
    auto moved = std::make_shared<Batch>(*b);
    moved->serial = next_serial();
    moved->origin += origin;
    frame_.batches.push_back(moved);
  }
  const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, -0.3}).linear(), 100, 80, 120);
  for (const bool snow : {true, false}) {
    frame_.surface = {snow ? 0.0F : 0.7F, snow ? 0.015F : 0.0F};
    show(still(frame_));
    const auto raster = cast(rays, 4, origin), exact = reference(rays, origin);
    std::size_t compared = 0, differ = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (raster[i].nothing() || exact[i].nothing() || raster[i].node.value != 1 || exact[i].node.value != 1)
        continue;
      ++compared;
      // Snow's pattern is looked up half a texel beside the ray: its slope is below 8 per metre.
      const double beside =
          0.7 / 500 * static_cast<double>(exact[i].range_m) / std::max(0.05F, exact[i].cos_incidence);
      differ +=
          std::abs(raster[i].reflectance - exact[i].reflectance) > 0.002 + (snow ? 8 * beside : 0.0) ? 1 : 0;
    }
    EXPECT_GT(compared, 3000U);
    EXPECT_LE(differ, compared / 200) << "snow " << snow << " of " << compared;
  }
}

}  // namespace
}  // namespace rigor::test
