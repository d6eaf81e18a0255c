// Estimates of a pose beside the truth: after a run (rigor localization) and while it goes on
// (/rigor/estimate).
#include "bench/motion/pose_error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

namespace rigor {
namespace {

constexpr double kPi = std::numbers::pi, kNone = std::numeric_limits<double>::quiet_NaN();

TEST(PoseAt, IsOnTheLineBetweenNeighboursAndTurnsTheShortWay) {
  const std::vector<PlanePose> truth{{0, 0, 0, 3.1}, {100'000'000, 1, -2, -3.1}};
  const auto p = pose_at(truth, 50'000'000);
  ASSERT_TRUE(p);
  EXPECT_DOUBLE_EQ(p->x_m, 0.5);
  EXPECT_DOUBLE_EQ(p->y_m, -1);
  EXPECT_NEAR(std::abs(p->yaw_rad), kPi, 1e-12);  // over ±π, not through 0
}

TEST(PoseAt, IsNotKnownFarFromEveryPose) {
  const std::vector<PlanePose> truth{{0, 0, 0, 0}, {kPoseReach_ns, 1, 0, 0}, {10 * kPoseReach_ns, 2, 0, 0}};
  EXPECT_TRUE(pose_at(truth, kPoseReach_ns / 2));
  EXPECT_FALSE(pose_at(truth, -1));
  EXPECT_FALSE(pose_at(truth, 5 * kPoseReach_ns));
  EXPECT_TRUE(pose_at(truth, 10 * kPoseReach_ns + kPoseReach_ns / 10));
  EXPECT_FALSE(pose_at(truth, 10 * kPoseReach_ns + kPoseReach_ns / 10 + 1));
  EXPECT_FALSE(pose_at({}, 0));
}

TEST(PoseError, IsForwardAndToTheLeftByTheTrueYaw) {
  const PlanePoseError e = pose_error({0, 1, 3, 0.1 - kPi}, {0, 1, 1, kPi / 2});
  EXPECT_NEAR(e.along_m, 2, 1e-12);
  EXPECT_NEAR(e.across_m, 0, 1e-12);
  EXPECT_NEAR(e.yaw_rad, kPi / 2 + 0.1, 1e-12);
  const PlanePoseError right = pose_error({0, 2, 1, 0}, {0, 1, 1, kPi / 2});
  EXPECT_NEAR(right.along_m, 0, 1e-12);
  EXPECT_NEAR(right.across_m, -1, 1e-12);
  const PlanePoseError left = pose_error({0, 1, 3, kNone}, {0, 1, 1, 0});
  EXPECT_NEAR(left.across_m, 2, 1e-12);
  EXPECT_TRUE(std::isnan(left.yaw_rad));
  EXPECT_NEAR(pose_error({0, 1, 3, 0}, {0, 1, 1, kNone}).across_m, 2, 1e-12);
}

}  // namespace
}  // namespace rigor
