#include "sim/nature/built/road_mesh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/sim/nature/built/mesh_checks.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

double plan_area(const std::vector<RoadPiece>& pieces, double* least = nullptr) {
  double sum = 0;
  for (const auto& piece : pieces)
    test::each_triangle(*piece.mesh,
                        [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface&) {
                          const Vector2d p = test::position(*piece.mesh, a).head<2>(),
                                         q = test::position(*piece.mesh, b).head<2>(),
                                         r = test::position(*piece.mesh, c).head<2>();
                          const Vector2d u = q - p, v = r - p;
                          const double twice = u.x() * v.y() - u.y() * v.x();
                          sum += twice / 2;
                          if (least) *least = std::min(*least, twice / 2);
                        });
  return sum;
}
double marked_area(const std::vector<RoadPiece>& pieces) {
  double sum = 0;
  for (const auto& p : pieces)
    sum += test::area_m2(*p.mesh,
                         [](const Vector3d&, const render::Surface& s) { return s.name == "road_marking"; });
  return sum;
}

TEST(Line, WhatIsNoneIsRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const auto& xy : std::vector<std::vector<double>>{
           {}, {1, 1}, {1, 1, 1, 1, 1, 1}, {0, 0, 1}, {0, 0, nan, 1}, {0, 0, 1, 1e300}})
    EXPECT_FALSE(line_from(xy, Vector2d::Zero())) << xy.size();
  const auto line = line_from(std::vector<double>{0, 0, 0, 0, 5, 0, 5, 0, 5, 5}, Vector2d::Zero());
  ASSERT_TRUE(line);
  EXPECT_EQ(line->size(), 3U);
}

TEST(Road, StraightOneHasItsAreaAndMarkings) {
  const auto pieces = make_road({.line = {{0, 0}, {90, 0}}, .width_m = 7});
  EXPECT_NEAR(plan_area(pieces), 90 * 7, 0.01);
  // Two edge lines, and ten dashes of 3 m along the middle.
  EXPECT_NEAR(marked_area(pieces), 2 * 90 * 0.12 + 10 * 3 * 0.12, 0.05);
  EXPECT_EQ(marked_area(make_road({.line = {{0, 0}, {90, 0}}, .width_m = 4})), 0);
  EXPECT_EQ(marked_area(make_road({.line = {{0, 0}, {90, 0}}, .width_m = 7, .surface = RoadSurface::gravel})),
            0);
}

TEST(Road, RightAngleIsSquareInsideAndRoundOutside) {
  const double w = 6;
  const auto pieces = make_road({.line = {{0, 0}, {40, 0}, {40, 40}}, .width_m = w});
  const double expected = 2 * 40 * w - w * w / 4 + M_PI / 4 * w * w / 4;
  EXPECT_NEAR(plan_area(pieces), expected, 0.05);
}

// How far a ribbon's edges run backwards, at worst.
double worst_step_back(const Line& line, double half_width_m) {
  const auto sections = ribbon(line, half_width_m);
  double worst = 0;
  for (std::size_t i = 0; i + 1 < sections.size(); ++i) {
    const Vector2d d = sections[i + 1].middle - sections[i].middle;
    if (d.norm() == 0) continue;
    for (const double s : {-1.0, 1.0})
      worst = std::min(worst, (sections[i + 1].at(s) - sections[i].at(s)).dot(d.normalized()));
  }
  return worst;
}

// A mitre without its limits folds the inside of these over.
TEST(Road, NeverFoldsOver) {
  Line winding;
  for (int i = 0; i < 60; ++i) winding.emplace_back(2.0 * i, 5 * std::sin(0.4 * i));
  const std::vector<Line> lines = {
      {{0, 0}, {30, 0}, {0, 0}},                                 // straight back
      {{0, 0}, {30, 0}, {0, 1}},                                 // nearly so
      {{0, 0}, {30, 0}, {30.5, 0.5}, {30, 1}, {0, 1}},           // a hairpin narrower than the road
      {{0, 0}, {1, 0}, {1, 1}, {2, 1}, {2, 2}, {3, 2}, {3, 3}},  // stairs finer than the road
      {{0, 0}, {20, 0}, {20, 20}, {0, 20}, {0, 0}},              // closed
      winding};
  for (std::size_t k = 0; k < lines.size(); ++k) {
    EXPECT_GE(worst_step_back(lines[k], 4), -1e-9) << k;
    double least = 0;
    const auto pieces = make_road({.line = lines[k], .width_m = 8});
    EXPECT_GT(plan_area(pieces, &least), 10) << k;
    EXPECT_GT(least, -1e-5) << k;
    for (const auto& p : pieces) EXPECT_GT(test::worst_normal(*p.mesh), 0.3);
  }
}

// Drawn too coarsely, the ground pokes through here.
TEST(Road, FollowsTheGroundFromJustAbove) {
  const auto ground = [](const Vector2d& p) { return 3 * std::sin(p.x() / 9) + 2 * std::cos(p.y() / 7); };
  const double w = 6;
  const auto pieces = make_road({.line = {{0, 0}, {80, 10}, {100, 60}}, .width_m = w, .ground = ground});
  double lowest = 1, highest = -1;
  for (const auto& piece : pieces)
    test::each_triangle(
        *piece.mesh, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface&) {
          const Vector3d p = test::position(*piece.mesh, a), q = test::position(*piece.mesh, b),
                         r = test::position(*piece.mesh, c);
          const Vector3d n = (q - p).cross(r - p);
          if (n.z() < 0.2 * n.norm()) return;  // a skirt
          for (const auto& m : {Vector3d((p + q + r) / 3), Vector3d((p + q) / 2), Vector3d((q + r) / 2)}) {
            const Vector3d at = m + piece.origin;
            const double above = at.z() - ground(at.head<2>());
            lowest = std::min(lowest, above);
            highest = std::max(highest, above);
          }
        });
  EXPECT_GT(lowest, 0.005);
  EXPECT_LT(highest, 0.04 + 0.025 * w / 2 + 0.04);
}

TEST(Road, SkirtsReachIntoTheGround) {
  const auto pieces = make_road({.line = {{0, 0}, {50, 0}}, .width_m = 5});
  double lowest = 0;
  for (const auto& p : pieces) lowest = std::min(lowest, p.origin.z() + p.mesh->bounds.min().z());
  EXPECT_LT(lowest, -0.3);
}

TEST(Road, HolesInTheGroundAreBridged) {
  const auto ground = [](const Vector2d& p) { return p.x() > 20 && p.x() < 30 ? std::nan("") : 7.0; };
  for (const auto& p : make_road({.line = {{0, 0}, {50, 0}}, .width_m = 5, .ground = ground}))
    for (const auto& v : p.mesh->vertices) {
      EXPECT_GT(v.position[2] + p.origin.z(), 6.5);
      EXPECT_LT(v.position[2] + p.origin.z(), 7.2);
    }
}

TEST(Road, LongOnesComeInPieces) {
  const auto pieces = make_road({.line = {{0, 0}, {1000, 0}}, .width_m = 5});
  EXPECT_GE(pieces.size(), 6U);
  for (const auto& p : pieces) EXPECT_LT(p.mesh->bounds.sizes().x(), 160);
  EXPECT_NEAR(plan_area(pieces), 5000, 0.1);
}

}  // namespace
}  // namespace rigor::nature::built
