// Where points lie and when they were measured: perfect sensors over shapes in closed form.
#include <tbb/global_control.h>

#include <cstring>

#include "tests/sim/sensors/lidar/lidar_test_support.h"

namespace rigor {
namespace {

using namespace test;
using models::LidarModel;

TEST(LidarGeometry, WallIsWhereItIs) {
  AnalyticWorld world;
  const auto s = scan(sweep(60, 0.25), wall(10), world, {.ideal = true});
  ASSERT_EQ(s.points.size(), 481U);
  for (std::size_t i = 0; i < s.points.size(); ++i) {
    const double azimuth = (-60 + 0.25 * static_cast<double>(i)) * kDegree;
    // Ranges and directions are float: 1e-7 of 20 m each, twice over at a slant of 60 degrees.
    EXPECT_NEAR(range_of(s.points[i]), 10 / std::cos(azimuth), 1e-5);
    EXPECT_NEAR(std::atan2(s.points[i].y_m, s.points[i].x_m), azimuth, 5e-7);
    EXPECT_NEAR(s.points[i].remission, 0.5 * std::cos(azimuth), 1e-6);
  }
}

TEST(LidarGeometry, SphereIsWhereItIs) {
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Sphere{.centre = {8, 1, 0}, .radius_m = 1.5});
  AnalyticWorld world;
  const auto s = scan(sweep(40, 0.1), engine, world, {.ideal = true});
  std::size_t met = 0;
  for (int i = 0; i <= 800; ++i) {
    const double a = (-40 + 0.1 * i) * kDegree, b = 8 * std::cos(a) + std::sin(a), q = b * b - (65 - 2.25);
    if (q <= 1e-6) continue;
    ASSERT_LT(met, s.points.size());
    EXPECT_NEAR(range_of(s.points[met]), b - std::sqrt(q), 3e-5) << i;  // steep at the limb
    ++met;
  }
  EXPECT_EQ(met, s.points.size());
  EXPECT_GT(met, 200U);
}

TEST(LidarGeometry, Vlp16FiresInTheOrderAndAtTheTimesOfItsManual) {
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Box{.half = {12, 9, 7}});
  AnalyticWorld world;
  const LidarModel m = config("velodyne-vlp16");
  const auto s = scan(m, engine, world, {.ideal = true});
  ASSERT_EQ(s.points.size(), 1809U * 16);
  const double elevation_deg[] = {-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15};
  for (std::size_t i = 0; i < s.points.size(); i += 7) {
    const LidarPoint& p = s.points[i];
    const std::size_t column = i / 16, ring = i % 16;
    ASSERT_EQ(p.ring, ring);
    const double t_us = 55.296 * static_cast<double>(column) + 2.304 * static_cast<double>(ring);
    ASSERT_EQ(p.t_offset_ns, std::lround(t_us * 1000));
    // Seen from where the beam starts, it points where it should: clockwise, 0.036 degrees a microsecond/10.
    const double z = static_cast<double>(p.z_m) - m.scan.beams[ring].vertical_offset_m;
    EXPECT_NEAR(std::atan2(z, std::hypot(p.x_m, p.y_m)), elevation_deg[ring] * kDegree, 1e-6);
    EXPECT_NEAR(std::remainder(std::atan2(p.y_m, p.x_m) + 2 * std::numbers::pi * 10 * t_us * 1e-6,
                               2 * std::numbers::pi),
                0, 1e-6);
  }
}

TEST(LidarGeometry, BeamsStartWhereTheirOffsetsSay) {
  LidarModel m = staring();
  m.scan.beams[0].vertical_offset_m = 0.1;
  m.scan.beams[0].horizontal_offset_m = 0.2;
  m.scan.beams[0].radial_offset_m = 0.05;
  m.scan.start_azimuth_rad = 90 * kDegree;  // looks left: left of the beam is −x
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = {0, 10, 0}, .normal = {0, -1, 0}});
  AnalyticWorld world;
  const auto s = scan(m, engine, world, {.ideal = true});
  ASSERT_EQ(s.points.size(), 1U);
  EXPECT_NEAR(s.points[0].x_m, -0.2, 1e-6);
  EXPECT_NEAR(s.points[0].y_m, 10, 1e-6);
  EXPECT_NEAR(s.points[0].z_m, 0.1, 1e-6);
}

render::PoseFunction driving(const Eigen::Vector3d& start, const Eigen::Vector3d& velocity,
                             double yaw_rate_radps = 0) {
  return [=](BenchTime t) {
    const double s = static_cast<double>(t.ns()) * 1e-9;
    Eigen::Isometry3d pose(Eigen::AngleAxisd(yaw_rate_radps * s, Eigen::Vector3d::UnitZ()));
    pose.translation() = start + velocity * s;
    return pose;
  };
}

TEST(LidarMotion, WallIsSkewedByThePlatformsVelocity) {
  AnalyticWorld world;
  const auto s =
      scan(sweep(60, 0.25), wall(10), world, {.ideal = true, .pose = driving({0, 0, 0}, {12, -3, 0})});
  ASSERT_EQ(s.points.size(), 481U);
  for (const LidarPoint& p : s.points) EXPECT_NEAR(p.x_m, 10 - 12 * (p.t_offset_ns * 1e-9), 2e-5);
  EXPECT_LT(s.points.back().x_m, 9.9F);  // 13 ms at 12 m/s: 160 mm
}

TEST(LidarMotion, EveryLaserOfASequenceHasItsOwnInstant) {
  LidarModel m = perfect(config("velodyne-vlp16"));
  for (models::LidarBeam& b : m.scan.beams) b.elevation_rad = 0;
  AnalyticWorld world;
  const auto s = scan(m, wall(20), world, {.ideal = true, .pose = driving({0, 0, 0}, {40, 0, 0})});
  std::size_t checked = 0;
  for (const LidarPoint& p : s.points)
    // 1.4 mm of way between the first laser of a sequence and the last.
    if (std::abs(p.y_m) < 20) {
      EXPECT_NEAR(p.x_m, 20 - 40 * (p.t_offset_ns * 1e-9), 3e-5);
      ++checked;
    }
  EXPECT_GT(checked, 3000U);
}

TEST(LidarMotion, TurningPlatformTurnsTheWall) {
  AnalyticWorld world;
  const double rate = 3.0;
  const auto s =
      scan(sweep(30, 0.25), wall(10), world, {.ideal = true, .pose = driving({0, 0, 0}, {0, 0, 0}, rate)});
  for (std::size_t i = 0; i < s.points.size(); ++i) {
    const double t = s.points[i].t_offset_ns * 1e-9, a = (-30 + 0.25 * static_cast<double>(i)) * kDegree;
    EXPECT_NEAR(range_of(s.points[i]), 10 / std::cos(a + rate * t), 3e-5);
  }
}

TEST(LidarMotion, MovingWallIsMetWhereItIsAtTheFiring) {
  AnalyticWorld world;
  const auto s = scan(staring(1001), wall(10, {.velocity_m_per_s = {50, 0, 0}}), world, {.ideal = true});
  ASSERT_EQ(s.points.size(), 1001U);
  for (const LidarPoint& p : s.points) EXPECT_NEAR(p.x_m, 10 + 50 * (p.t_offset_ns * 1e-9), 1e-5);
  EXPECT_GT(world.asked_instants, 1);
}

TEST(LidarMotion, FarFromTheOriginNothingIsLost) {
  AnalyticWorld world;
  const Eigen::Vector3d far(100e3, -70e3, 300);
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = far + Eigen::Vector3d(10, 0, 0), .normal = {-1, 0, 0}});
  const auto s = scan(sweep(60, 1), engine, world, {.ideal = true, .pose = driving(far, {5, 0, 0})});
  ASSERT_EQ(s.points.size(), 121U);
  for (const LidarPoint& p : s.points) EXPECT_NEAR(p.x_m, 10 - 5 * (p.t_offset_ns * 1e-9), 2e-5);
}

TEST(LidarMotion, RosetteGoesOnFromScanToScan) {
  LidarModel m = perfect(config("rosette"));
  m.scan.columns = 500;
  AnalyticWorld world;
  const auto first = scan(m, wall(10), world, {.ideal = true});
  const auto again = scan(m, wall(10), world, {.ideal = true});
  const auto later = scan(m, wall(10), world, {.ideal = true, .index = 1, .t = BenchTime(100'000'000)});
  ASSERT_EQ(first.points.size(), 500U);
  ASSERT_EQ(later.points.size(), 500U);
  std::size_t same = 0;
  for (std::size_t i = 0; i < 500; ++i) {
    EXPECT_NEAR(first.points[i].x_m, 10, 1e-5);
    EXPECT_EQ(first.points[i].y_m, again.points[i].y_m);
    same += first.points[i].y_m == later.points[i].y_m;
  }
  EXPECT_LT(same, 5U);
}

TEST(LidarLimits, NothingOutsideTheRangeLimits) {
  LidarModel m = staring();
  m.range = {.min_m = 1, .max_m = 20};
  AnalyticWorld world;
  for (const bool ideal : {false, true}) {
    EXPECT_EQ(scan(m, wall(0.99), world, {.ideal = ideal}).points.size(), 0U);
    EXPECT_EQ(scan(m, wall(1.01), world, {.ideal = ideal}).points.size(), 1U);
    EXPECT_EQ(scan(m, wall(19.99), world, {.ideal = ideal}).points.size(), 1U);
    EXPECT_EQ(scan(m, wall(20.01), world, {.ideal = ideal}).points.size(), 0U);
  }
}

TEST(LidarLimits, OwnHousingIsNotMet) {
  auto engine = wall(10);
  engine->add(Sphere{.centre = {0, 0, 0}, .radius_m = 0.05});
  LidarModel m = staring();
  AnalyticWorld world;
  EXPECT_NEAR(range_of(scan(m, engine, world).points.at(0)), 0.05, 1e-6);
  m.range.housing_m = 0.1;
  EXPECT_NEAR(range_of(scan(m, engine, world).points.at(0)), 10, 1e-5);
}

TEST(LidarLimits, EmptyWorldHasNoPointsAndAnInsideHasAll) {
  AnalyticWorld world;
  auto engine = std::make_shared<AnalyticEngine>();
  for (const char* name : {"velodyne-vlp16", "sick-lms511", "rosette"}) {
    EXPECT_EQ(scan(config(name), engine, world).points.size(), 0U) << name;
  }
  engine->add(Sphere{.centre = {0.3, 0.2, 0}, .radius_m = 5});
  LidarModel m = perfect(config("velodyne-vlp16"));
  const auto s = scan(m, engine, world);
  EXPECT_EQ(s.points.size(), m.firings());
}

TEST(LidarCreate, RefusesWhatCannotBe) {
  auto engine = std::make_shared<AnalyticEngine>();
  LidarModel m = staring();
  m.footprint.sub_rays = 0;
  auto none = LidarSimulator::create({.name = "l", .model = m}, engine);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::bad_input);
  EXPECT_FALSE(LidarSimulator::create({.name = "l", .model = staring()}, nullptr));
  auto lidar = LidarSimulator::create({.name = "l", .model = staring()}, engine);
  ASSERT_TRUE(lidar);
  AnalyticWorld world;
  std::vector<LidarPoint> points;
  const auto nowhere = still({std::nan(""), 0, 0});
  const Status bad = (*lidar)->capture({}, {world, nowhere}, points);
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().code, ErrorCode::bad_input);
}

TEST(LidarThreads, GiveTheSameBytesWhateverTheirNumber) {
  AnalyticWorld world;
  world.frame.precipitation = {.kind = render::Precipitation::Kind::rain,
                               .drops_per_m3 = 300,
                               .diameter_m = 1.5e-3F,
                               .extinction_per_m = grey(1.5e-3F)};
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Box{.half = {12, 9, 7}}, {.node = {7}});
  engine->add(Sphere{.centre = {6, 2, 0}, .radius_m = 1}, {.retro_reflection = 0.5F, .node = {8}});
  LidarModel m = config("velodyne-vlp16");
  m.echoes.returns = models::LidarReturns::dual;
  m.scan.columns = 300;
  Scanned reference;
  for (const std::size_t threads : {1U, 2U, 4U}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    const auto s = scan(m, engine, world, {.pose = driving({0, 0, 0}, {3, 1, 0}, 0.5)});
    if (threads == 1) {
      reference = s;
      ASSERT_GT(s.points.size(), 4000U);
      continue;
    }
    ASSERT_EQ(s.points.size(), reference.points.size());
    EXPECT_EQ(std::memcmp(s.points.data(), reference.points.data(), s.points.size() * sizeof(LidarPoint)), 0);
    EXPECT_EQ(s.truth.node, reference.truth.node);
  }
}

TEST(LidarTruth, NamesWhatWasMet) {
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = {10, 0, 0}, .normal = {-1, 0, 0}}, {.node = {3}});
  engine->add(Sphere{.centre = {5, 0, 0}, .radius_m = 0.5}, {.node = {4}});
  AnalyticWorld world;
  world.types = {{world::NodeId{3}, "Body"}, {world::NodeId{4}, "Tree"}};
  // The sensor looks along world y when the platform is turned: normals are the sensor's.
  const auto turned = [](BenchTime) {
    Eigen::Isometry3d pose(Eigen::AngleAxisd(20 * kDegree, Eigen::Vector3d::UnitZ()));
    return pose;
  };
  LidarModel m = sweep(40, 1);
  m.noise.floor_m = 0.05;
  const auto s = scan(m, engine, world, {.pose = turned});
  ASSERT_EQ(s.points.size(), 81U);
  EXPECT_EQ(s.truth.class_names.at(0), "");
  std::size_t trees = 0;
  for (std::size_t i = 0; i < s.points.size(); ++i) {
    const double a = (-40 + static_cast<double>(i) + 20) * kDegree;
    const bool on_sphere = std::abs(std::sin(a)) * 5 < 0.5;
    EXPECT_EQ(s.truth.node[i], on_sphere ? 4U : 3U) << i;
    EXPECT_EQ(s.truth.class_names.at(s.truth.class_index[i]), on_sphere ? "Tree" : "Body");
    if (on_sphere) {
      ++trees;
      continue;
    }
    EXPECT_NEAR(s.truth.range_m[i], 10 / std::cos(a), 1e-5);  // without the noise
    EXPECT_NEAR(s.truth.normal[3 * i], -std::cos(20 * kDegree), 1e-6);
    EXPECT_NEAR(s.truth.normal[3 * i + 1], std::sin(20 * kDegree), 1e-6);
  }
  EXPECT_EQ(trees, 11U);
}

}  // namespace
}  // namespace rigor
