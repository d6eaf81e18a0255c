// The nodes of the world that sensors measure in, as a motion has them.
#include "bench/sensing/sensor_world.h"

#include <gtest/gtest.h>

#include "sim/platform/trajectory.h"
#include "tests/paths.h"

namespace rigor {
namespace {

std::unique_ptr<SensorWorld> testbed() {
  auto world = SensorWorld::open(test::source_dir() + "/configs/worlds/testbed.yaml");
  EXPECT_TRUE(world) << world.error().text();
  const std::vector<TimedPose> poses{{0, {}}, {1, {}}};
  WorldPlatform cart;
  cart.name = "cart";
  cart.model = std::make_shared<TrajectoryPlatform>(*Trajectory::make(poses));
  EXPECT_TRUE((*world)->add_platform(cart));
  return std::move(*world);
}

/// Sensors on it ask for the platform, others see its node.
TEST(SensorWorld, MovesAPlatformsNodeWithItsAcceleration) {
  const auto world = testbed();
  const world::NodeId node = world->platform_nodes().at(0).second;
  WorldMotion motion;
  motion.body_count = 1;
  motion.body[0].velocity_mps = {1, 0, 0};
  motion.body[0].turn_rate_radps = {0, 0, 0.5};
  const BenchTime t = BenchTime(0) + milliseconds(100);
  for (const double acceleration_mps2 : {0.0, 2.0, -3.0}) {
    motion.body[0].acceleration_mps2 = {acceleration_mps2, 0, 0};
    const SensorWorld::Moment moment(*world, motion);
    EXPECT_NEAR(moment.T_world_node(node, t).translation().x(), 0.1 + 0.005 * acceleration_mps2, 1e-12);
    EXPECT_TRUE(moment.T_world_node(node, t).isApprox(moment.T_world_platform(0, t), 1e-12));
  }
}

}  // namespace
}  // namespace rigor
