#include "sensor-hal/record/laser_scan.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

namespace rigor::record {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

LidarPoint at(double angle_deg, double range_m, float remission = 5, std::uint8_t return_index = 0) {
  return {.x_m = static_cast<float>(range_m * std::cos(angle_deg * kDegree)),
          .y_m = static_cast<float>(range_m * std::sin(angle_deg * kDegree)),
          .z_m = 0,
          .remission = remission,
          .t_offset_ns = 0,
          .ring = 0,
          .return_index = return_index,
          .flags = 0};
}

/// 270 degrees by half a degree, as a SICK LMS111 scans.
ScanLine lms() {
  return {.angle_min_rad = -135 * kDegree,
          .angle_increment_rad = 0.5 * kDegree,
          .rays = 541,
          .time_increment_s = 0.02 / 720,
          .scan_time_s = 0.02,
          .range_min_m = 0.5,
          .range_max_m = 20};
}

TEST(LaserScan, HasEachRayAtItsPlaceAndRep117ForTheOthers) {
  const std::vector<LidarPoint> points{
      at(-135, 3, 7), at(0, 4), at(135, 5), at(10, 0.2), at(20, 25), at(30, std::nan("")), at(0, 9, 1, 1)};
  msg::LaserScan scan;
  EXPECT_EQ(fill_laser_scan(lms(), points, false, scan), 1U) << "the one that is no number lies nowhere";
  ASSERT_EQ(scan.ranges.size(), 541U);
  EXPECT_FLOAT_EQ(scan.angle_min, static_cast<float>(-135 * kDegree));
  EXPECT_FLOAT_EQ(scan.angle_max, static_cast<float>(135 * kDegree));
  EXPECT_FLOAT_EQ(scan.scan_time, 0.02F);
  EXPECT_FLOAT_EQ(scan.ranges[0], 3);
  EXPECT_EQ(scan.intensities[0], 7);
  EXPECT_FLOAT_EQ(scan.ranges[270], 4) << "the second return of a ray is left out";
  EXPECT_FLOAT_EQ(scan.ranges[540], 5);
  EXPECT_EQ(fill_laser_scan(lms(), std::vector{at(5, 3), at(5.1, 2, 8), at(5, 4)}, false, scan), 0U);
  EXPECT_FLOAT_EQ(scan.ranges[280], 2) << "the nearest of a ray";
  EXPECT_EQ(scan.intensities[280], 8);
  EXPECT_EQ(fill_laser_scan(lms(), points, false, scan), 1U);
  EXPECT_EQ(scan.ranges[290], -kInfinity) << "nearer than range_min";
  EXPECT_EQ(scan.ranges[310], kInfinity) << "beyond range_max";
  EXPECT_EQ(scan.ranges[100], kInfinity) << "nothing came back";
  EXPECT_EQ(fill_laser_scan(lms(), points, true, scan), 1U);
  EXPECT_TRUE(std::isnan(scan.ranges[100])) << "of an incomplete sample it is not known";
  EXPECT_FLOAT_EQ(scan.ranges[270], 4);
}

TEST(LaserScan, BeginsWhereTheDeviceDoes) {
  std::vector<LidarPoint> points;
  for (int i = 0; i < 100; ++i) points.push_back(at(-120 + 0.5 * i + 0.24, 2));
  ScanLine line = lms();
  EXPECT_TRUE(align(line, points));
  EXPECT_NEAR(line.angle_min_rad, (-135 + 0.24) * kDegree, 1e-6);
  EXPECT_TRUE(align(line, points));
  EXPECT_NEAR(line.angle_min_rad, (-135 + 0.24) * kDegree, 1e-6) << "once is enough";
  line = lms();
  EXPECT_FALSE(align(line, std::span(points).first(7)));
  for (int i = 0; i < 100; ++i) points[static_cast<std::size_t>(i)] = at(-120 + 0.37 * i, 2);
  EXPECT_FALSE(align(line, points)) << "of another step";
  EXPECT_EQ(line, lms());
}

TEST(LaserScan, LeavesOutWhatIsBesideItsRays) {
  const std::vector<LidarPoint> points{at(135.2, 2), at(135.4, 2), at(180, 2), at(-135.2, 2), at(-135.4, 2)};
  msg::LaserScan scan;
  EXPECT_EQ(fill_laser_scan(lms(), points, false, scan), 3U);
  EXPECT_FLOAT_EQ(scan.ranges[540], 2);
  EXPECT_FLOAT_EQ(scan.ranges[0], 2);
}

TEST(LaserScan, OfAWholeTurnThatCrossesTheSeamAndOfAClockwiseOne) {
  ScanLine line = lms();
  line.angle_min_rad = 90 * kDegree;
  line.angle_increment_rad = 1 * kDegree;
  line.rays = 360;
  msg::LaserScan scan;
  EXPECT_EQ(fill_laser_scan(line, std::vector{at(90, 1), at(180, 2), at(-179, 3), at(0, 4), at(89, 5)}, false,
                            scan),
            0U);
  EXPECT_FLOAT_EQ(scan.ranges[0], 1);
  EXPECT_FLOAT_EQ(scan.ranges[90], 2);
  EXPECT_FLOAT_EQ(scan.ranges[91], 3);
  EXPECT_FLOAT_EQ(scan.ranges[270], 4);
  EXPECT_FLOAT_EQ(scan.ranges[359], 5);
  line.angle_increment_rad = -1 * kDegree;
  EXPECT_EQ(fill_laser_scan(line, std::vector{at(90, 1), at(89, 2), at(91, 3)}, false, scan), 0U);
  EXPECT_FLOAT_EQ(scan.ranges[1], 2);
  EXPECT_FLOAT_EQ(scan.ranges[359], 3);
  EXPECT_LT(scan.angle_increment, 0);
}

}  // namespace
}  // namespace rigor::record
