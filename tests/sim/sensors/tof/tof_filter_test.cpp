// A time-of-flight camera's own filters.
#include "sim/sensors/tof/tof_filters.h"

#include "tests/sim/sensors/tof/tof_fixture.h"

namespace rigor::test {
namespace {

using models::TofFilters;

TofPicture picture(int width, int height, const std::function<double(int, int)>& range_m) {
  TofPicture p;
  p.width_px = std::uint32_t(width);
  p.height_px = std::uint32_t(height);
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) p.range_m.push_back(float(range_m(u, v)));
  p.amplitude.assign(p.range_m.size(), 1000);
  p.status.assign(p.range_m.size(), TofPixelStatus::valid);
  return p;
}
TofPicture filtered(const TofFilters& f, TofPicture p) {
  std::vector<float> scratch;
  tof::filter(f, p, scratch);
  return p;
}

TEST(TofFilters, MedianRemovesALoneSpikeAndKeepsEdges) {
  const auto scene = [](int u, int) { return u < 6 ? 1.0 : 2.0; };
  TofPicture p = picture(12, 10, scene);
  p.range_m[5 * 12 + 3] = 4.5F;
  p.range_m[2 * 12 + 9] = std::nanf("");
  for (const int side : {3, 5}) {
    const TofPicture q = filtered({.median_px = side}, p);
    for (int v = 0; v < 10; ++v)
      for (int u = 0; u < 12; ++u)
        if (v == 2 && u == 9)
          ASSERT_TRUE(std::isnan(q.range_m[size_t(v * 12 + u)]));  // stays unknown
        else
          ASSERT_EQ(q.range_m[size_t(v * 12 + u)], float(scene(u, v))) << u << ' ' << v;
  }
}

TEST(TofFilters, FlyingPixelsAreRemovedAndNothingElse) {
  // A step with one mixed column; a slope as steep as the step's halves; a pole one pixel wide.
  const auto scene = [](int u, int v) {
    if (v < 8) return u < 8 ? 1.0 : u == 8 ? 1.6 : 2.2;
    if (v < 16) return 1.0 + 0.3 * u;
    return u == 5 ? 1.0 : 3.0;
  };
  const TofPicture q = filtered({.flying_pixel_m = 0.1}, picture(16, 24, scene));
  for (int v = 0; v < 24; ++v)
    for (int u = 0; u < 16; ++u) {
      if (v == 7 || v == 8 || v == 15 || v == 16) continue;  // seams of the three scenes
      const std::size_t i = size_t(v * 16 + u);
      const bool mixed = v < 7 && u == 8;
      ASSERT_EQ(q.status[i], mixed ? TofPixelStatus::filtered : TofPixelStatus::valid) << u << ' ' << v;
      ASSERT_EQ(std::isnan(q.range_m[i]), mixed);
    }
  // Below the threshold nothing is.
  const TofPicture kept = filtered({.flying_pixel_m = 0.7}, picture(16, 24, scene));
  for (const auto s : kept.status) ASSERT_EQ(s, TofPixelStatus::valid);
}

TEST(TofFilters, FlyingPixelRemovalTakesTheMixedPixelsOfASceneAlone) {
  models::TofModel m = perfect(9, 40, 20000);
  m.sampling.samples = 16;
  m.filters.flying_pixel_m = 0.03;
  TofBench b;
  b.wall(2.6, 0.8F);
  const double x = (4.1 - m.cx_px) / m.fx_px * 1.4;
  b.engine->add(Rectangle{.centre = {x - 5, 0, 1.4}, .half_u = {5, 0, 0}, .half_v = {0, 5, 0}});
  const TofPicture p = b.shoot(m);
  for (int v = 0; v < 40; ++v)
    for (int u = 0; u < 9; ++u)
      ASSERT_EQ(p.status[size_t(v * 9 + u)], u == 4 ? TofPixelStatus::filtered : TofPixelStatus::valid);
}

TEST(TofFilters, BilateralSmoothsNoiseAndKeepsSteps) {
  std::uint32_t state = 7;
  const auto noise = [&] {
    state = state * 1664525u + 1013904223u;
    return (double(state >> 8) / (1 << 24) - 0.5) * 0.02;
  };
  const TofPicture p = picture(40, 40, [&](int u, int) { return (u < 20 ? 1.0 : 2.0) + noise(); });
  const TofPicture q =
      filtered({.bilateral_radius_px = 3, .bilateral_sigma_px = 2, .bilateral_sigma_m = 0.05}, p);
  std::vector<float> before, after;
  for (int v = 3; v < 37; ++v)
    for (int u = 0; u < 20; ++u)
      before.push_back(p.range_m[size_t(v * 40 + u)]), after.push_back(q.range_m[size_t(v * 40 + u)]);
  EXPECT_LT(spread_of(after).sigma, 0.35 * spread_of(before).sigma);
  EXPECT_NEAR(spread_of(after).mean, 1.0, 1e-3);
  for (int v = 0; v < 40; ++v) {
    ASSERT_NEAR(q.range_m[size_t(v * 40 + 19)], 1.0, 0.011);
    ASSERT_NEAR(q.range_m[size_t(v * 40 + 20)], 2.0, 0.011);
  }
}

TEST(TofFilters, OffLeavesThePictureAlone) {
  const TofPicture p = picture(8, 8, [](int u, int v) { return 1 + u * 0.3 + v * v; });
  const TofPicture q = filtered({}, p);
  EXPECT_EQ(p.range_m, q.range_m);
}

}  // namespace
}  // namespace rigor::test
