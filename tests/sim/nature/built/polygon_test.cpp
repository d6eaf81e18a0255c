#include "sim/nature/built/polygon.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "sensor-hal/models/philox.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
const double kNaN = std::numeric_limits<double>::quiet_NaN();

struct Made {
  Result<Polygon> polygon;
  std::vector<std::string> mended;
};
Made made(std::vector<double> footprint, std::vector<double> holes = {}, Vector2d origin = Vector2d::Zero()) {
  Made m{.polygon = {}, .mended = {}};
  m.polygon = polygon_from(footprint, holes, origin, m.mended);
  return m;
}

TEST(Polygon, ClockwiseRingIsTurnedRound) {
  const auto m = made({0, 0, 0, 5, 10, 5, 10, 0});
  ASSERT_TRUE(m.polygon);
  EXPECT_DOUBLE_EQ(signed_area(m.polygon->outer), 50);
  EXPECT_TRUE(m.mended.empty());
}

TEST(Polygon, PointsTwiceOrOnALineAreDropped) {
  const auto m = made({0, 0, 0, 0, 5, 0, 10, 0, 10, 5, 10, 5.0001, 0, 5, 0, 0});
  ASSERT_TRUE(m.polygon);
  EXPECT_EQ(m.polygon->outer.size(), 4U);
  EXPECT_NEAR(area(*m.polygon), 50, 0.01);
}

TEST(Polygon, SpikeIsCutOff) {
  const auto m = made({0, 0, 10, 0, 20, 0, 10, 0, 10, 5, 0, 5});
  ASSERT_TRUE(m.polygon);
  EXPECT_EQ(m.polygon->outer.size(), 4U);
  EXPECT_NEAR(area(*m.polygon), 50, 1e-9);
}

TEST(Polygon, WhatHasNoAreaIsRefused) {
  for (const auto& numbers : std::vector<std::vector<double>>{{},
                                                              {1, 2},
                                                              {0, 0, 1, 1},
                                                              {0, 0, 5, 0, 10, 0},
                                                              {3, 3, 3, 3, 3, 3, 3, 3},
                                                              {0, 0, 10, 0, 10, 1e-5, 0, 1e-5},
                                                              {0, 0, 1, 0, 1},
                                                              {0, 0, kNaN, 0, 1, 1},
                                                              {0, 0, 1e300, 0, 1, 1}}) {
    const auto m = made(numbers);
    ASSERT_FALSE(m.polygon) << numbers.size() << " numbers";
    EXPECT_EQ(m.polygon.error().code, ErrorCode::bad_input);
  }
}

TEST(Polygon, BowTieIsRefusedButASmallLoopIsCutOff) {
  EXPECT_FALSE(made({0, 0, 10, 10, 10, 0, 0, 10}).polygon);
  EXPECT_FALSE(made({0, 0, 10, 10, 10, 0, 0, 8}).polygon);
  // The corner (10, 5) is passed by a triangle of 0.25 m².
  const auto m = made({0, 0, 10, 0, 10, 5.5, 10.5, 5, 0, 5});
  ASSERT_TRUE(m.polygon) << m.polygon.error().message;
  EXPECT_NEAR(area(*m.polygon), 50, 0.2);
  EXPECT_TRUE(is_simple(*m.polygon, 1e-4));
}

TEST(Polygon, HoleThatTouchesIsDrawnInAndOneOutsideIsLeftOut) {
  auto m = made({0, 0, 10, 0, 10, 10, 0, 10}, {8, 0, 4, 4, 4, 4, 6, 0, 6});
  ASSERT_TRUE(m.polygon);
  ASSERT_EQ(m.polygon->holes.size(), 1U);
  EXPECT_EQ(m.mended.size(), 1U);
  EXPECT_LT(signed_area(m.polygon->holes[0]), 0);
  EXPECT_TRUE(is_simple(*m.polygon, 0.01));
  m = made({0, 0, 10, 0, 10, 10, 0, 10}, {8, 20, 4, 24, 4, 24, 6, 20, 6});
  ASSERT_TRUE(m.polygon);
  EXPECT_TRUE(m.polygon->holes.empty());
  EXPECT_EQ(m.mended.size(), 1U);
  m = made({0, 0, 10, 0, 10, 10, 0, 10}, {8, 5, 5, 15, 5, 15, 7, 5, 7});  // crosses
  ASSERT_TRUE(m.polygon);
  EXPECT_TRUE(m.polygon->holes.empty());
}

TEST(Polygon, HoleWhoseCountLiesIsLeftOut) {
  for (const double count : {9.0, -2.0, 2.5, kNaN, 1e300}) {
    const auto m = made({0, 0, 10, 0, 10, 10, 0, 10}, {count, 4, 4, 6, 4, 6, 6});
    ASSERT_TRUE(m.polygon);
    EXPECT_TRUE(m.polygon->holes.empty());
    EXPECT_EQ(m.mended.size(), 1U) << count;
  }
}

TEST(Polygon, FarFromTheOriginNothingIsLost) {
  const Vector2d far(4.5e6, -5.5e6);
  std::vector<double> xy;
  for (const auto& p : {Vector2d(0.125, 0), Vector2d(10, 0), Vector2d(10, 5.25), Vector2d(0.125, 5.25)})
    xy.insert(xy.end(), {p.x() + far.x(), p.y() + far.y()});
  const auto m = made(xy, {}, origin_near(xy));
  ASSERT_TRUE(m.polygon);
  EXPECT_NEAR(area(*m.polygon), 9.875 * 5.25, 1e-9);
}

TEST(Polygon, OffsetMovesEveryEdgeByItsOwnDistance) {
  const auto m = made({0, 0, 10, 0, 10, 5, 0, 5});
  const auto out = offset(*m.polygon, std::vector<double>{1, 2, 0, 0.5});
  ASSERT_TRUE(out);
  EXPECT_NEAR(area(*out), 12.5 * 6, 1e-9);
  EXPECT_FALSE(offset(*m.polygon, -2.6)) << "nothing is left";
}

// Fails where an ear is taken that holds another corner, or a bridge runs through a hole.
TEST(Triangulate, CoversPolygonsWithHolesOnce) {
  for (std::uint32_t k = 0; k < 300; ++k) {
    const auto draw = [k](std::uint32_t i) {
      return models::philox({i, k, 0, 0}, models::channel_key(7, 1))[0] * 0x1p-32;
    };
    const int n = 3 + static_cast<int>(draw(0) * 40);
    std::vector<double> xy, holes;
    for (int i = 0; i < n; ++i) {
      const double a = 2 * M_PI * i / n, r = 10 + 20 * draw(100 + static_cast<std::uint32_t>(i));
      xy.insert(xy.end(), {r * std::cos(a), r * std::sin(a)});
    }
    for (int h = 0; h < 3; ++h) {  // three small holes around the middle, where every star has room
      holes.push_back(8);
      const double x = 1.5 * std::cos(2.1 * h), y = 1.5 * std::sin(2.1 * h);
      for (const auto& [dx, dy] : {std::pair(-0.4, -0.4), {0.4, -0.5}, {0.5, 0.4}, {-0.4, 0.4}})
        holes.insert(holes.end(), {x + dx, y + dy});
    }
    const auto m = made(xy, n >= 5 ? holes : std::vector<double>{});
    ASSERT_TRUE(m.polygon);
    double sum = 0;
    for (const auto& t : triangulate(*m.polygon)) {
      const double own = signed_area(Ring(t.begin(), t.end()));
      EXPECT_GT(own, 0);
      sum += own;
      EXPECT_TRUE(contains(*m.polygon, (t[0] + t[1] + t[2]) / 3)) << k;
    }
    EXPECT_NEAR(sum, area(*m.polygon), 1e-9 * sum) << k;
  }
}

}  // namespace
}  // namespace rigor::nature::built
