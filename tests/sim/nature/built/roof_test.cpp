#include <gtest/gtest.h>

#include <cmath>

#include "sensor-hal/models/philox.h"
#include "sim/nature/built/building_roof.h"
#include "sim/nature/built/roof_sweep.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Polygon rectangle(double length, double width) {
  return {.outer = {{0, 0}, {length, 0}, {length, width}, {0, width}}, .holes = {}};
}
std::vector<double> ones(const Polygon& p) { return std::vector<double>(p.edge_count(), 1.0); }

// On a roof of slope 1 every point of an edge's face is as high as it is far from that edge's line.
double worst_height_m(const Polygon& p, const RoofSweep& roof) {
  std::vector<std::pair<Vector2d, Vector2d>> edges;
  for (const auto& r : p.rings())
    for (std::size_t i = 0; i < r.size(); ++i)
      edges.emplace_back(r[i], (r[(i + 1) % r.size()] - r[i]).normalized());
  double worst = 0;
  for (const Facet& f : roof.shell.facets) {
    const auto& [a, d] = edges[static_cast<std::size_t>(f.tag)];
    for (const int i : f.corner) {
      const Vector3d& q = roof.shell.points[static_cast<std::size_t>(i)];
      const double off = d.x() * (q.y() - a.y()) - d.y() * (q.x() - a.x());
      worst = std::max(worst, std::abs(off - q.z()));
    }
  }
  return worst;
}

TEST(RoofSweep, RectangleIsAHipWithItsRidgeInTheMiddle) {
  const Polygon p = rectangle(12, 6);
  const auto roof = sweep_roof(p, ones(p));
  ASSERT_TRUE(roof);
  EXPECT_NEAR(roof->height_m, 3, 1e-9);
  EXPECT_LT(worst_height_m(p, *roof), 1e-5);
  EXPECT_EQ(roof->is_hip_end, (std::vector<bool>{false, true, false, true}));
  EXPECT_EQ(gable_speeds(p, *roof), (std::vector<double>{1, 0, 1, 0}));
}

TEST(RoofSweep, SquareGetsTwoGablesThatFaceEachOther) {
  const Polygon p = rectangle(8, 8);
  const auto roof = sweep_roof(p, ones(p));
  ASSERT_TRUE(roof);
  const auto speeds = gable_speeds(p, *roof);
  EXPECT_EQ(speeds, (std::vector<double>{0, 1, 0, 1}));
  ASSERT_TRUE(sweep_roof(p, speeds));
}

TEST(RoofSweep, TeeHasThreeGables) {
  const Polygon p{.outer = {{0, 0}, {12, 0}, {12, 4}, {8, 4}, {8, 10}, {4, 10}, {4, 4}, {0, 4}}, .holes = {}};
  const auto roof = sweep_roof(p, ones(p));
  ASSERT_TRUE(roof);
  const auto speeds = gable_speeds(p, *roof);
  EXPECT_EQ(std::count(speeds.begin(), speeds.end(), 0.0), 3);
  ASSERT_TRUE(sweep_roof(p, speeds));
}

// Everything happens at once here: 64 edges vanish in one point, or fronts of equal width meet.
TEST(RoofSweep, TiesAreSettled) {
  Polygon round;
  for (int i = 0; i < 64; ++i)
    round.outer.emplace_back(10 * std::cos(M_PI * i / 32), 10 * std::sin(M_PI * i / 32));
  const Polygon cross{.outer = {{4, 0},
                                {8, 0},
                                {8, 4},
                                {12, 4},
                                {12, 8},
                                {8, 8},
                                {8, 12},
                                {4, 12},
                                {4, 8},
                                {0, 8},
                                {0, 4},
                                {4, 4}},
                      .holes = {}};
  const Polygon court{.outer = {{0, 0}, {20, 0}, {20, 16}, {0, 16}},
                      .holes = {{{5, 5}, {5, 11}, {15, 11}, {15, 5}}}};
  for (const Polygon& p : {round, cross, court}) {
    const auto roof = sweep_roof(p, ones(p));
    ASSERT_TRUE(roof);
    EXPECT_LT(worst_height_m(p, *roof), 1e-4);
  }
  EXPECT_NEAR(sweep_roof(court, ones(court))->height_m, 2.5, 1e-9);
}

TEST(RoofSweep, AnyOutlineGetsItsRoof) {
  int failed = 0;
  for (std::uint32_t k = 0; k < 600; ++k) {
    const auto draw = [k](std::uint32_t i) {
      return models::philox({i, k, 0, 0}, models::channel_key(11, 2))[0] * 0x1p-32;
    };
    Polygon p;
    const int n = 4 + static_cast<int>(draw(0) * 26);
    for (int i = 0; i < n; ++i) {
      const double a = 2 * M_PI * i / n, r = 3 + 10 * draw(10 + static_cast<std::uint32_t>(i));
      p.outer.emplace_back(r * std::cos(a), r * std::sin(a));
    }
    const auto roof = sweep_roof(p, ones(p));
    if (!roof)
      ++failed;
    else
      EXPECT_LT(worst_height_m(p, *roof), 1e-3) << k;
  }
  EXPECT_LE(failed, 2) << "of 600 stars; such a building gets a flat roof and a warning";
}

double total_volume(const Roof& roof) {
  double sum = 0;
  for (const Shell& s : roof.shells) {
    EXPECT_TRUE(open_edges(s).empty());
    sum += volume(s);
  }
  return sum;
}

TEST(Roof, VolumesAreThoseOfTheFormulas) {
  const double l = 12, w = 6, h = 2.5;
  const Polygon p = rectangle(l, w);
  const auto made = [&](RoofShape shape) {
    return make_roof(p, {.shape = shape, .eaves_m = 5, .height_m = h});
  };
  EXPECT_NEAR(total_volume(made(RoofShape::gabled)), l * w * h / 2, 1e-6);
  EXPECT_NEAR(total_volume(made(RoofShape::hipped)), w * h / 2 * (l - w) + w * w * h / 3, 1e-6);
  EXPECT_NEAR(total_volume(made(RoofShape::pyramidal)), l * w * h / 3, 1e-6);
  EXPECT_NEAR(total_volume(made(RoofShape::shed)), l * w * h / 2, 1e-6);
  const double parapet = l * w - (l - 0.5) * (w - 0.5);
  EXPECT_NEAR(total_volume(make_roof(p, {.shape = RoofShape::flat, .eaves_m = 5, .height_m = 0.4})),
              0.4 * parapet, 1e-6);
}

TEST(Roof, RidgeIsAsHighAsAskedWithAndWithoutOverhang) {
  const Polygon p = rectangle(12, 6);
  for (const auto shape : {RoofShape::gabled, RoofShape::hipped, RoofShape::pyramidal})
    for (const double overhang : {0.0, 0.35, 1.0}) {
      const Roof roof = make_roof(p, {.shape = shape, .eaves_m = 5, .height_m = 2.5, .overhang_m = overhang});
      ASSERT_TRUE(roof.top);
      EXPECT_NEAR(roof.top->z(), 7.5, 1e-6);
      EXPECT_TRUE(roof.warnings.empty());
      for (const Shell& s : roof.shells) EXPECT_TRUE(open_edges(s).empty());
    }
}

TEST(Roof, RectanglesOfASurveyAreGabled) {
  // To the centimetre, turned, so that no two walls are quite parallel; also far from the origin.
  for (const Vector2d& far : {Vector2d(0, 0), Vector2d(4000, -3000)})
    for (int turn = 0; turn < 90; ++turn) {
      const double a = turn * 0.0349, c = std::cos(a), s = std::sin(a);
      Polygon p = rectangle(18, 12);
      for (Vector2d& q : p.outer)
        q = far + Vector2d(std::round((c * q.x() - s * q.y()) * 100) / 100,
                           std::round((s * q.x() + c * q.y()) * 100) / 100);
      const Roof roof = make_roof(p, {.shape = RoofShape::gabled});
      EXPECT_EQ(roof.shape, RoofShape::gabled) << turn;
      EXPECT_TRUE(roof.warnings.empty()) << turn << ": " << roof.warnings[0];
    }
}

TEST(Roof, ShapesThatDoNotFitSaySo) {
  const Polygon u{.outer = {{0, 0}, {14, 0}, {14, 10}, {10, 10}, {10, 4}, {4, 4}, {4, 10}, {0, 10}},
                  .holes = {}};
  const Roof pyramid = make_roof(u, {.shape = RoofShape::pyramidal});
  EXPECT_EQ(pyramid.shape, RoofShape::hipped);
  EXPECT_EQ(pyramid.warnings.size(), 1U);
  const Polygon triangle{.outer = {{0, 0}, {10, 0}, {3, 7}}, .holes = {}};
  const Roof gabled = make_roof(triangle, {.shape = RoofShape::gabled});
  EXPECT_EQ(gabled.shape, RoofShape::hipped);
  EXPECT_EQ(gabled.warnings.size(), 1U);
}

}  // namespace
}  // namespace rigor::nature::built
