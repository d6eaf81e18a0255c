#include "sensor-hal/models/lidar/scan_grid.h"

#include <gtest/gtest.h>

#include <cmath>

#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "tests/paths.h"

namespace rigor::models {
namespace {

/// A return at a range along a firing of a scan, as a simulator writes it.
LidarPoint point_of(const LidarScan& scan, std::uint32_t column, std::uint16_t beam, double range_m,
                    double turn_rad = 0) {
  const LidarBeam& b = scan.beams[beam];
  const LidarAim aim =
      rotor_aim(b, scan.azimuth_rad(column) + scan.rotation_radps * b.fire_time_s + turn_rad);
  LidarPoint p{};
  p.x_m = static_cast<float>(aim.origin_m[0] + range_m * aim.direction[0]);
  p.y_m = static_cast<float>(aim.origin_m[1] + range_m * aim.direction[1]);
  p.z_m = static_cast<float>(aim.origin_m[2] + range_m * aim.direction[2]);
  p.remission = static_cast<float>(beam);
  p.t_offset_ns =
      static_cast<std::int32_t>(std::lround((column * scan.column_period_s + b.fire_time_s) * 1e9));
  p.ring = beam;
  return p;
}

LidarScan vlp16() {
  auto model = load_lidar_model(rigor::test::source_dir() + "/configs/sensors/velodyne-vlp16.yaml");
  return model.value().scan;
}

TEST(ScanGrid, FindsTheFiringAndTheRangeOfEveryReturn) {
  const LidarScan scan = vlp16();
  for (const double turn : {0.0, 0.0031}) {
    auto grid = ScanGrid::create(scan);
    ASSERT_TRUE(grid) << grid.error().text();
    std::vector<LidarPoint> points;
    // Every third firing has a return; the farther the later.
    const auto range_of = [](std::size_t firing) { return 0.5 + 99.0 * static_cast<double>(firing) / 30000; };
    std::size_t firing = 0;
    for (std::uint32_t c = 0; c < scan.columns; ++c)
      for (std::uint16_t b = 0; b < 16; ++b, ++firing)
        if (firing % 3 == 0) points.push_back(point_of(scan, c, b, range_of(firing), turn));
    grid->fill(points, turn);
    EXPECT_EQ(grid->strays(), 0u);
    firing = 0;
    for (std::uint32_t c = 0; c < scan.columns; ++c)
      for (std::uint16_t b = 0; b < 16; ++b, ++firing) {
        const double expected = firing % 3 == 0 ? range_of(firing) : 0;
        // Three coordinates of single precision below 128 m.
        ASSERT_NEAR(grid->at(c, b).range_m, expected, 2e-5) << "column " << c << " beam " << b;
        ASSERT_EQ(grid->at(c, b, 1).range_m, 0) << "column " << c << " beam " << b;
        if (expected > 0) {
          ASSERT_EQ(grid->at(c, b).remission, b);
        }
      }
  }
}

TEST(ScanGrid, TakesSecondReturnsAndForgetsTheScanBefore) {
  const LidarScan scan = vlp16();
  auto grid = ScanGrid::create(scan).value();
  std::vector<LidarPoint> points{point_of(scan, 7, 3, 10), point_of(scan, 7, 3, 12)};
  points[1].return_index = 1;
  grid.fill(points);
  EXPECT_NEAR(grid.at(7, 3, 0).range_m, 10, 1e-5);
  EXPECT_NEAR(grid.at(7, 3, 1).range_m, 12, 1e-5);
  grid.fill({});
  EXPECT_EQ(grid.at(7, 3, 0).range_m, 0);
  EXPECT_EQ(grid.at(7, 3, 1).range_m, 0);
}

TEST(ScanGrid, CountsPointsThatBelongToNoFiring) {
  const LidarScan scan = vlp16();
  auto grid = ScanGrid::create(scan).value();
  std::vector<LidarPoint> points(6, point_of(scan, 0, 0, 10));
  points[1].ring = 16;
  points[2].return_index = 2;
  points[3].t_offset_ns = -60'000;      // a column before the first
  points[4].t_offset_ns = 200'000'000;  // after the last
  points[5].t_offset_ns = 27'000;       // between two
  grid.fill(points);
  EXPECT_EQ(grid.strays(), 5u);
}

TEST(ScanGrid, RefusesARosette) {
  LidarScan scan = vlp16();
  scan.kind = LidarScanKind::rosette;
  EXPECT_FALSE(ScanGrid::create(scan));
}

}  // namespace
}  // namespace rigor::models
