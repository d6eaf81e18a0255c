// What the tests of the LiDAR simulator share: small models and one call for a scan.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "tests/paths.h"
#include "tests/sim/sensors/analytic_engine.h"

namespace rigor::test {

inline constexpr double kDegree = std::numbers::pi / 180;

/// One beam along x that fires `shots` times, 10 µs apart.
[[nodiscard]] inline models::LidarModel staring(std::uint32_t shots = 1) {
  models::LidarModel m;
  m.scan.columns = shots;
  m.scan.column_period_s = 1e-5;
  return m;
}
/// A 2D scanner: from −half to half by steps, anticlockwise, 25 turns a second.
[[nodiscard]] inline models::LidarModel sweep(double half_deg, double step_deg) {
  models::LidarModel m;
  m.scan.columns = static_cast<std::uint32_t>(std::lround(2 * half_deg / step_deg)) + 1;
  m.scan.start_azimuth_rad = -half_deg * kDegree;
  m.scan.rotation_radps = 2 * std::numbers::pi * 25;
  m.scan.column_period_s = step_deg * kDegree / m.scan.rotation_radps;
  return m;
}
[[nodiscard]] inline models::LidarModel config(const std::string& name) {
  auto m = load_lidar_model(rigor::test::source_dir() + "/configs/sensors/" + name + ".yaml");
  EXPECT_TRUE(m) << m.error().text();
  return m ? *m : models::LidarModel{};
}
/// The same device without any error: scan, range limits and the scale of its remission alone.
[[nodiscard]] inline models::LidarModel perfect(models::LidarModel m) {
  const models::LidarModel none;
  m.footprint = none.footprint;
  m.echoes = none.echoes;
  m.detection = none.detection;
  m.noise = none.noise;
  m.retro = none.retro;
  m.sun = none.sun;
  m.air = none.air;
  m.range.step_m = 0;
  m.remission = none.remission;
  return m;
}

struct Scanned {
  std::vector<LidarPoint> points;
  GroundTruth truth;
};
struct ScanOptions {
  bool ideal = false;
  std::uint64_t seed = 1, index = 0;
  std::string name = "lidar";
  BenchTime t{};
  render::PoseFunction pose = still();
};
[[nodiscard]] inline Scanned scan(const models::LidarModel& model,
                                  const std::shared_ptr<render::RayEngine>& engine, AnalyticWorld& world,
                                  const ScanOptions& o = {}) {
  Scanned s;
  auto lidar =
      LidarSimulator::create({.name = o.name, .model = model, .seed = o.seed, .ideal = o.ideal}, engine);
  EXPECT_TRUE(lidar) << lidar.error().text();
  if (!lidar) return s;
  const Status ok =
      (*lidar)->capture({.index = o.index, .t_capture = o.t}, {world, o.pose}, s.points, &s.truth);
  EXPECT_TRUE(ok) << ok.error().text();
  EXPECT_LE(s.points.size(), (*lidar)->max_points());
  EXPECT_EQ(s.truth.node.size(), s.points.size());
  return s;
}
[[nodiscard]] inline double range_of(const LidarPoint& p) {
  return std::sqrt(static_cast<double>(p.x_m) * p.x_m + static_cast<double>(p.y_m) * p.y_m +
                   static_cast<double>(p.z_m) * p.z_m);
}
[[nodiscard]] inline std::shared_ptr<AnalyticEngine> wall(double x_m, Look look = {}) {
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = {x_m, 0, 0}, .normal = {-1, 0, 0}}, std::move(look));
  return engine;
}

struct PointMoments {
  double mean = 0, sigma = 0;
};
template <class F>
[[nodiscard]] PointMoments moments(const std::vector<LidarPoint>& points, const F& value) {
  double sum = 0, square = 0;
  for (const LidarPoint& p : points) sum += value(p);
  const auto n = static_cast<double>(points.size());
  for (const LidarPoint& p : points) square += (value(p) - sum / n) * (value(p) - sum / n);
  return {sum / n, std::sqrt(square / (n - 1))};
}

}  // namespace rigor::test
