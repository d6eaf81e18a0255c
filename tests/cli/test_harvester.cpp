// The harvester's rig as far as its first cut: what lies there is in the next scans.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "bench/run/assembly.h"
#include "bench/run/bench_run.h"
#include "builtin/registry.h"
#include "cli/overrides.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sim/platform/platform.h"
#include "sim/world/pose.h"
#include "sim/world/semantic_types.h"
#include "tests/cli/command.h"

namespace rigor {
namespace {

/// As the rig mounts them on the cabin, and the platform model the cabin on the machine.
Eigen::Isometry3d mounted(double x_m, double y_m, double z_m, double pitch_deg, double yaw_deg) {
  constexpr double kRad = std::numbers::pi / 180;
  return Eigen::Translation3d(-0.2 + x_m, y_m, 3.6 + z_m) *
         Eigen::AngleAxisd(yaw_deg * kRad, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(pitch_deg * kRad, Eigen::Vector3d::UnitY());
}

class HarvesterRig : public ::testing::Test {
 protected:
  /// What a scanner of the rig, with its limits and its noise, measures at an instant; in the world's frame.
  std::vector<Eigen::Vector3d> scan(const char* channel, const Eigen::Isometry3d& T_body_sensor,
                                    BenchTime t) {
    std::vector<Eigen::Vector3d> points;
    for (const ChannelEntry& entry : assembly->parts.rig.channels) {
      if (entry.name != channel) continue;
      auto lidar =
          assembly->simulation->sampler(SampleKind::point_cloud, entry.source.params, 1, channel, {});
      EXPECT_TRUE(lidar) << lidar.error().text();
      if (!lidar) break;
      auto pool = make_sample_pool(1, (*lidar)->geometry().max_bytes);
      SampleSlot slot = pool->try_acquire();
      SampleProvider::Request request;
      request.t_capture = t;
      request.motion = assembly->parts.motion.motion_at(t);
      EXPECT_TRUE((*lidar)->capture(request, *slot));
      const Eigen::Isometry3d T = isometry_of(request.motion.body[0].at(t)) * T_body_sensor;
      for (std::size_t i = 0; i < slot->as<PointCloudInfo>()->count; ++i) {
        LidarPoint p;
        std::memcpy(&p, slot->bytes().data() + i * sizeof p, sizeof p);
        points.push_back(T * Eigen::Vector3d(p.x_m, p.y_m, p.z_m));
      }
    }
    return points;
  }
  std::unique_ptr<Assembly> assembly;
};

TEST_F(HarvesterRig, ItsNextScansHaveTheTrunkOnTheGround) {
  const auto overrides = parse_overrides({"duration_s=17.2", "simulation.workers=1"});
  ASSERT_TRUE(overrides);
  auto config = load_rig(test::config("rigs/harvester.yaml"), *overrides);
  ASSERT_TRUE(config) << config.error().text();
  auto made = assemble(std::move(*config), make_registry());
  ASSERT_TRUE(made) << made.error().text();
  assembly = std::move(*made);
  BenchRun bench(assembly->parts, nullptr);
  const auto armed = bench.arm();
  ASSERT_TRUE(armed) << armed.error().text();
  StopSource stop;
  const auto outcome = bench.run(stop.token());
  ASSERT_TRUE(outcome) << outcome.error().text();

  // The first marked tree, cut by now.
  const auto cuts = assembly->simulation->platforms()[0].model->fellings();
  ASSERT_EQ(cuts.size(), 1u);
  const Eigen::Vector2d foot(8.574, -4.473), along(std::cos(cuts[0].yaw_rad), std::sin(cuts[0].yaw_rad));
  const auto trunk = [&](const std::vector<Eigen::Vector3d>& points) {
    return std::count_if(points.begin(), points.end(), [&](const Eigen::Vector3d& p) {
      const Eigen::Vector2d d = p.head<2>() - foot;
      const double ahead = d.dot(along), beside = d.x() * along.y() - d.y() * along.x();
      return ahead > 1 && ahead < 14 && std::abs(beside) < 0.2 && p.z() > 0.06 && p.z() < 0.3;
    });
  };
  constexpr std::int64_t kPeriod_ns = 80'000'000;
  const BenchTime before(cuts[0].t.ns() / kPeriod_ns * kPeriod_ns), after = before + nanoseconds(kPeriod_ns);
  const Eigen::Isometry3d ground = mounted(0.8, 0, 0.2, 22, 0);
  EXPECT_EQ(trunk(scan("ground", ground, before)), 0);
  for (int k = 0; k < 3; ++k) {
    EXPECT_GE(trunk(scan("ground", ground, after + k * nanoseconds(kPeriod_ns))), 3) << k;
  }
}

}  // namespace
}  // namespace rigor
