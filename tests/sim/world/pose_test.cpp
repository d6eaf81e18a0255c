#include "sim/world/pose.h"

#include <gtest/gtest.h>

#include <random>

namespace rigor {
namespace {

/// The angle between what the rotation makes of `from` and where it should be, rad.
double error_rad(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const Eigen::Vector3d turned = rotation_between(from, to) * from.normalized();
  return turned.cross(to.normalized()).norm() + (turned.dot(to) < 0 ? 1 : 0);
}

TEST(RotationBetween, TurnsAnyDirectionIntoAnyOther) {
  std::mt19937 rng(5);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector3d a(normal(rng), normal(rng), normal(rng)), b(normal(rng), normal(rng), normal(rng));
    EXPECT_LT(error_rad(a, b), 1e-13);
    EXPECT_NEAR(rotation_between(a, b).norm(), 1, 2e-14);
    // The smallest one: its axis is across both.
    EXPECT_NEAR(rotation_between(a, b).vec().dot(a), 0, 1e-13);
  }
}

TEST(RotationBetween, OfEqualOppositeAndNearlyOppositeDirections) {
  const Eigen::Vector3d z = Eigen::Vector3d::UnitZ();
  EXPECT_TRUE(rotation_between(z, 7 * z).isApprox(Eigen::Quaterniond::Identity(), 0));
  for (const double off : {0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3}) {
    const Eigen::Vector3d down(off, 0, -1);
    EXPECT_LT(error_rad(z, down), 2e-6) << off;
    EXPECT_NEAR(rotation_between(z, down).norm(), 1, 1e-12) << off;
  }
}

}  // namespace
}  // namespace rigor
