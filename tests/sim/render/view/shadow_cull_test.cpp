#include <gtest/gtest.h>

#include <random>

#include "sim/render/view/shadow_cascades.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

/// Points that are seen, and things anywhere on their way to the light: none may be left out. Fails where
/// receivers end at half their reach, or an outline at nine tenths.
TEST(ViewShadowCulling, KeepsAllThatStandsBetweenTheLightAndWhatIsSeen) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(0, 1);
  const Eigen::AlignedBox3d content(Eigen::Vector3d(-300, -300, -20), Eigen::Vector3d(300, 300, 60));
  std::size_t tried = 0, left_out = 0, asked = 0, outside = 0;
  for (int round = 0; round < 60; ++round) {
    ViewRequest request;
    request.pinhole = pinhole(160, 120, 60 + 300 * unit(random));
    if (round % 2 == 1) {  // a band of a picture, off the optical axis
      request.pinhole.cx_px += 300 * unit(random) - 150;
      request.pinhole.cy_px += 300 * unit(random) - 150;
    }
    const Eigen::Vector3d eye(1e5 + 10 * unit(random), -2e5, 3);
    request.T_world_camera = look(eye, eye + direction(360 * unit(random), 120 * unit(random) - 89));
    const ViewCamera camera(request);
    const Eigen::Vector3d sun = direction(360 * unit(random), 3 + 86.5 * unit(random));
    auto all = shadow_cascades(camera, sun, content, {.side_px = 512, .reach_m = 400});
    double from = 0.05;
    const auto [left, right, top, bottom] = camera.edges();
    for (const ShadowCascade& c : all) {
      for (int i = 0; i < 200; ++i) {
        const double d = from + (c.view_depth_m - from) * unit(random);
        const Eigen::Vector3d seen =
            d * (camera.forward + (left + (right - left) * unit(random)) * camera.right +
                 (top + (bottom - top) * unit(random)) * camera.down);
        if (!content.contains(seen)) continue;
        outside += c.reaches(eye + seen, -2 * c.texel_m) ? 0 : 1;  // with what its filter looks at
        const double radius = 0.05 + 3 * unit(random);
        const Eigen::Vector3d off = radius * (2 * unit(random) - 1) * sun.unitOrthogonal();
        ++tried;
        left_out += c.may_shade(eye + seen + sun * (100 * unit(random)) + off, radius * 1.01) ? 0 : 1;
        // And things that lie about: not all may be kept.
        const Eigen::Vector3d about = 300 * Eigen::Vector3d(2 * unit(random) - 1, 2 * unit(random) - 1, 0);
        asked += c.may_shade(eye + about, 1) ? 1 : 0;
      }
      from = c.view_depth_m;
    }
  }
  EXPECT_GT(tried, 5000U);
  EXPECT_EQ(left_out, 0U);
  EXPECT_EQ(outside, 0U);
  EXPECT_LT(asked, tried / 4);
}

}  // namespace
}  // namespace rigor::test
