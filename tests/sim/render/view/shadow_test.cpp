#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

class ViewShadow : public ViewTest {};

/// The far end of the shadow of a post, from the picture: along each direction from its foot, how far the
/// ground is dark.
TEST_F(ViewShadow, OfAPostPointsAwayFromTheSunAndIsAsLongAsItShouldBe) {
  // A post of 2 m, 6 cm wide, seen from 16 m above: 90 px to a metre.
  request_.pinhole = pinhole(1000, 1000, 1440);
  request_.T_world_camera = look({0, 0, 16}, {0, 0, 0});
  auto post = box_mesh({0.03F, 0.03F, 1}, SurfaceOf::grey(0.5F), {0, 0, 1});
  frame_.batches = {one(plane_mesh(40, SurfaceOf::grey(0.5F)), 1), one(post, 2)};
  for (const double elevation : {25.0, 40.0, 60.0})
    for (const double azimuth : {0.0, 77.0, 200.0, 315.0}) {
      set_sun(azimuth, elevation, 5);
      const auto p = shoot();
      if (azimuth == 77.0) save(p, "post" + std::to_string(static_cast<int>(elevation)));
      const double lit = 0.5 / std::numbers::pi * 5 * std::sin(deg(elevation));
      // Weighted by how dark each pixel of the ground is: the shadow's middle line.
      const auto dark_at = [&](double x, double y) {
        const int u = static_cast<int>(std::lround(499.5 + x * 90)),
                  v = static_cast<int>(std::lround(499.5 - y * 90));
        if (u < 0 || v < 0 || u > 999 || v > 999 || node(p, u, v) != 1) return 0.0;
        return std::clamp(1.0 - static_cast<double>(pixel(p, u, v)[0]) / lit, 0.0, 1.0);
      };
      const double length = 2 / std::tan(deg(elevation));
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      for (double y = -5.5; y < 5.5; y += 1.0 / 90)
        for (double x = -5.5; x < 5.5; x += 1.0 / 90) {
          const double r = std::hypot(x, y);
          if (r > 0.5 * length && r < 0.9 * length) sum += dark_at(x, y) * Eigen::Vector2d(x, y);
        }
      const double seen_azimuth = std::atan2(sum.x(), sum.y()) * 180 / std::numbers::pi;
      const double off = std::remainder(seen_azimuth - (azimuth + 180), 360.0);
      EXPECT_LT(std::abs(off), 1.0) << "azimuth " << azimuth << ", elevation " << elevation;
      // Where it is half dark along the true direction, off the post's own picture (its top leans out in it).
      const Eigen::Vector2d away(-std::sin(deg(azimuth)), -std::cos(deg(azimuth)));
      double end = 0;
      for (double r = 0.5; r < 1.5 * length; r += 0.002)
        if (dark_at(away.x() * r, away.y() * r) > 0.5) end = r;
      // The top's far edge throws the end.
      const double half = 0.03 * (std::abs(away.x()) + std::abs(away.y()));
      EXPECT_NEAR(end, length + half, 0.02 * length) << "azimuth " << azimuth << ", elevation " << elevation;
    }
}

TEST_F(ViewShadow, FlatGroundAndGentleSlopesDoNotShadeThemselves) {
  Mesh m;
  for (int j = 0; j < 60; ++j)
    for (int i = 0; i < 60; ++i) {
      const auto z = [](int x, int y) {
        return 0.4F * std::sin(0.35F * static_cast<float>(x)) * std::cos(0.3F * static_cast<float>(y));
      };
      const auto p = [&](int x, int y) {
        return Eigen::Vector3f(static_cast<float>(x - 30), static_cast<float>(y), z(x, y));
      };
      add_quad(m, p(i, j), p(i + 1, j), p(i + 1, j + 1), p(i, j + 1));
    }
  auto ground = finished(std::move(m), SurfaceOf::grey(0.5F));
  request_.T_world_camera = look({0, -2, 2}, {0, 20, 0});
  for (const double elevation : {70.0, 40.0, 25.0}) {
    frame_.batches = {one(ground, 1)};
    set_sun(150, elevation, 5);
    const auto shaded = shoot();
    request_.switches.shadows = false;
    const auto plain = shoot();
    request_.switches.shadows = true;
    save(shaded, "acne" + std::to_string(static_cast<int>(elevation)));
    std::size_t darker = 0, ground_pixels = 0;
    for (std::size_t i = 0; i < plain.nodes.size(); ++i) {
      if (plain.nodes[i] == 0) continue;
      ++ground_pixels;
      darker += shaded.radiance[4 * i] < 0.97F * plain.radiance[4 * i] ? 1 : 0;
    }
    EXPECT_LT(darker, ground_pixels / 500) << elevation;
  }
}

TEST_F(ViewShadow, BehindAWallNoLightLeaksThrough) {
  // A wall that stands on the ground; the sun behind it.
  frame_.batches = {one(plane_mesh(40, SurfaceOf::grey(0.5F)), 1),
                    one(box_mesh({10, 0.1F, 2}, SurfaceOf::grey(0.5F), {0, 10, 2}), 2)};
  set_sun(0, 45, 5);
  request_.T_world_camera = look({0, 2, 2.5}, {0, 8.5, 0});
  const auto p = shoot();
  save(p, "wall");
  int seen = 0;
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u) {
      if (node(p, u, v) != 1) continue;
      const double z = static_cast<double>(depth(p, u, v));
      const Eigen::Vector3d at =
          request_.T_world_camera * Eigen::Vector3d((u - 79.5) / 150 * z, (v - 59.5) / 150 * z, z);
      if (at.y() > 6.3 && at.y() < 9.88) {
        ++seen;
        EXPECT_LT(pixel(p, u, v)[0], 0.02F) << at.transpose();
      }
      if (at.y() < 5.5) {
        EXPECT_GT(pixel(p, u, v)[0], 0.5F) << at.transpose();
      }
    }
  EXPECT_GT(seen, 500);
}

}  // namespace
}  // namespace rigor::test
