// Simulated LiDARs whose scan pattern is a table or a formula.
#include "sim/sensors/lidar/scan_rays.h"
#include "tests/sim/sensors/lidar/lidar_test_support.h"

namespace rigor {
namespace {

using namespace rigor::test;
using models::LidarModel;

LidarModel pattern_model(const std::string& csv, std::int64_t scan_ns, bool periodic) {
  auto table = models::parse_scan_pattern(csv, "p.csv").value();
  if (periodic) {
    EXPECT_TRUE(models::set_period(table, 0));
  }
  LidarModel m;
  m.scan = models::table_scan(std::make_shared<models::PatternTable>(std::move(table)), scan_ns);
  return m;
}
std::shared_ptr<AnalyticEngine> inside_a_sphere() {
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Sphere{.centre = {0, 0, 0}, .radius_m = 10});
  return engine;
}

TEST(LidarPattern, LooksWhereTheTableSaysAndWhen) {
  const LidarModel m = pattern_model("0,0,0\n0.0004,90,0\n0.001,180,30\n0.002,-90,-60\n", 2'500'000, true);
  AnalyticWorld world;
  const auto s = scan(m, inside_a_sphere(), world);
  ASSERT_EQ(s.points.size(), 4u);
  const double az[] = {0, 90, 180, -90}, el[] = {0, 0, 30, -60};
  const std::int32_t offset_ns[] = {0, 400'000, 1'000'000, 2'000'000};
  for (std::size_t i = 0; i < 4; ++i) {
    const LidarPoint& p = s.points[i];
    EXPECT_NEAR(p.x_m, 10 * std::cos(el[i] * kDegree) * std::cos(az[i] * kDegree), 1e-5);
    EXPECT_NEAR(p.y_m, 10 * std::cos(el[i] * kDegree) * std::sin(az[i] * kDegree), 1e-5);
    EXPECT_NEAR(p.z_m, 10 * std::sin(el[i] * kDegree), 1e-5);
    EXPECT_EQ(p.t_offset_ns, offset_ns[i]);
    EXPECT_EQ(p.ring, 0);
  }
}

TEST(LidarPattern, GoesOnWhereTheLastScanEndedAndEndsWithTheTable) {
  const std::string csv = "0,1,0\n0.001,2,0\n0.002,3,0\n0.003,4,0\n0.004,5,0\n";
  AnalyticWorld world;
  const auto seen = [&](bool periodic, std::uint64_t index) {
    // The time of the bench does not change which part of the pattern is scanned.
    const auto s = scan(pattern_model(csv, 2'000'000, periodic), inside_a_sphere(), world,
                        {.index = index, .t = BenchTime(123'456'789'000'000)});
    std::vector<std::pair<long, int>> told;
    for (const LidarPoint& p : s.points)
      told.emplace_back(std::lround(std::atan2(p.y_m, p.x_m) / kDegree), p.t_offset_ns);
    return told;
  };
  using Told = std::vector<std::pair<long, int>>;
  EXPECT_EQ(seen(true, 0), (Told{{1, 0}, {2, 1'000'000}}));
  EXPECT_EQ(seen(true, 1), (Told{{3, 0}, {4, 1'000'000}}));
  EXPECT_EQ(seen(true, 2), (Told{{5, 0}, {1, 1'000'000}}));
  EXPECT_EQ(seen(true, 3), (Told{{2, 0}, {3, 1'000'000}}));
  EXPECT_EQ(seen(false, 2), (Told{{5, 0}}));
  EXPECT_EQ(seen(false, 3), Told{});
  // A simulator that has no firings now has them again: scans do not depend on what was asked before.
  auto lidar =
      LidarSimulator::create({.name = "l", .model = pattern_model(csv, 2'000'000, false)}, inside_a_sphere())
          .value();
  std::vector<LidarPoint> points(7);
  ASSERT_TRUE(lidar->capture({.index = 9}, {world, still()}, points));
  EXPECT_EQ(points.size(), 0u);
  ASSERT_TRUE(lidar->capture({.index = 1}, {world, still()}, points));
  EXPECT_EQ(points.size(), 2u);
}

TEST(LidarPattern, SeesEachFiringFromWhereTheSensorIsThen) {
  // Uneven steps, so that only the table's own times are right.
  std::string csv;
  for (int i = 0; i < 200; ++i) csv += std::to_string(i * i * 1e-6) + ",0,0\n";
  const LidarModel m = pattern_model(csv, 50'000'000, false);
  AnalyticWorld world;
  const auto ahead = [](BenchTime t) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation().x() = 20 * static_cast<double>(t.ns()) * 1e-9;
    return pose;
  };
  const auto s = scan(m, wall(10), world, {.ideal = true, .pose = ahead});
  ASSERT_EQ(s.points.size(), 200u);
  for (std::size_t i = 0; i < 200; ++i) {
    EXPECT_EQ(s.points[i].t_offset_ns, static_cast<std::int32_t>(i * i * 1000));
    EXPECT_NEAR(s.points[i].x_m, 10 - 20 * (s.points[i].t_offset_ns * 1e-9), 1e-4);
  }
}

TEST(LidarPattern, EachFiringHasTheDivergenceOfItsRow) {
  LidarModel m = pattern_model("0,0,0,10\n0.001,0,0,40\n0.002,0,0,0\n", 3'000'000, true);
  m.footprint = {.horizontal_divergence_rad = 0.1, .vertical_divergence_rad = 0.1, .sub_rays = 5};
  lidar::ScanRays rays(m, false);
  rays.begin_scan(0, BenchTime(0));
  ASSERT_EQ(rays.firings(), 3u);
  lidar::Track track;
  track.follow(still(), BenchTime(0), milliseconds(3), 3);
  std::vector<render::Ray> cast(rays.rays_in_tile(0));
  rays.fill_tile(0, track, 100, cast);
  const auto widest = [&](std::uint32_t firing) {
    float most = 0;
    for (std::uint32_t k = 0; k < rays.sub_rays(); ++k) {
      const render::Ray& r = cast[rays.ray_in_tile(0, firing, 0) + k];
      most = std::max(most, std::hypot(r.direction[1], r.direction[2]) / r.direction[0]);
    }
    return most;
  };
  EXPECT_GT(widest(0), 0.003F);
  EXPECT_LT(widest(0), 0.005F + 1e-5F);
  EXPECT_NEAR(widest(1) / widest(0), 4, 0.01);
  EXPECT_EQ(widest(2), 0);
}

TEST(LidarPattern, OfTheMid360ContinuesFromScanToScan) {
  LidarModel m;
  m.scan = models::formula_scan(models::PatternFormula::livox_mid360, 10'000'000);
  AnalyticWorld world;
  for (const std::uint64_t index : {0, 7}) {
    const auto s = scan(m, inside_a_sphere(), world, {.index = index, .t = BenchTime(5'000'000'000)});
    ASSERT_EQ(s.points.size(), 2000u);
    for (std::size_t i = 0; i < s.points.size(); ++i) {
      const LidarPoint& p = s.points[i];
      ASSERT_EQ(p.t_offset_ns, static_cast<std::int32_t>(i * 5000));
      ASSERT_EQ(p.ring, i % 4);
      const auto d = models::livox_mid360_direction(
          p.ring, static_cast<double>(index) * 0.01 + static_cast<double>(i) * 5e-6);
      ASSERT_NEAR(p.x_m, 10 * d[0], 2e-5);
      ASSERT_NEAR(p.y_m, 10 * d[1], 2e-5);
      ASSERT_NEAR(p.z_m, 10 * d[2], 2e-5);
    }
  }
}

}  // namespace
}  // namespace rigor
