// Paths through poses: what they pass, and that all derivatives are those of the pose.
#include "sim/platform/trajectory.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

namespace rigor {
namespace {

constexpr double kPi = std::numbers::pi;

Eigen::Quaterniond rotation(const Pose& p) {
  const auto& q = p.orientation_wxyz;
  return {q[0], q[1], q[2], q[3]};
}
Eigen::Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }
TimedPose pose(double t_s, const Eigen::Vector3d& p, const Eigen::Quaterniond& q) {
  return {t_s, {{p.x(), p.y(), p.z()}, {q.w(), q.x(), q.y(), q.z()}}};
}
BodyState at(const Trajectory& path, double t_s) { return path.at(t_s, BenchTime(0) + seconds_from(t_s)); }

/// A way with uneven spans that turns about all axes, once by nearly half a turn.
std::vector<TimedPose> winding() {
  std::vector<TimedPose> poses;
  double t = 0.5;
  for (int i = 0; i < 9; ++i) {
    t += 0.4 + 0.1 * (i % 4);
    const double a = i == 5 ? 2.9 : 0.5 * i;
    poses.push_back(pose(t, Eigen::Vector3d(2 * i, 3 * std::sin(0.9 * i), 0.4 * (i % 3)),
                         Eigen::AngleAxisd(a, Eigen::Vector3d(0.3, -0.2 * i, 1).normalized()) *
                             Eigen::Quaterniond::Identity()));
  }
  return poses;
}

class Paths : public ::testing::TestWithParam<PathSpline> {};

TEST_P(Paths, PassThroughTheirPoses) {
  const auto poses = winding();
  const auto path = Trajectory::make(poses, GetParam());
  ASSERT_TRUE(path);
  for (const TimedPose& p : poses) {
    const BodyState b = at(*path, p.t_s);
    EXPECT_LT((vector(b.T_world_body.position_m) - vector(p.T_world_body.position_m)).norm(), 1e-12);
    EXPECT_LT(rotation(b.T_world_body).angularDistance(rotation(p.T_world_body)), 1e-7);
  }
  EXPECT_EQ(at(*path, 0).velocity_mps, (std::array<double, 3>{}));
  EXPECT_LT(
      (vector(at(*path, 100).T_world_body.position_m) - vector(poses.back().T_world_body.position_m)).norm(),
      1e-12);
}

TEST_P(Paths, HaveTheDerivativesOfTheirPose) {
  const auto poses = winding();
  const auto path = Trajectory::make(poses, GetParam());
  ASSERT_TRUE(path);
  const double h = 1e-5;
  for (double t = poses.front().t_s + 0.013; t < poses.back().t_s - 0.01; t += 0.0271) {
    bool knot = false;
    for (const TimedPose& p : poses) knot |= std::abs(p.t_s - t) < 2 * h;
    if (knot) continue;
    const BodyState b = at(*path, t), before = at(*path, t - h), after = at(*path, t + h);
    const Eigen::Vector3d v =
        (vector(after.T_world_body.position_m) - vector(before.T_world_body.position_m)) / (2 * h);
    EXPECT_LT((v - vector(b.velocity_mps)).norm(), 1e-7) << t;
    const Eigen::Vector3d a = (vector(after.velocity_mps) - vector(before.velocity_mps)) / (2 * h);
    EXPECT_LT((a - vector(b.acceleration_mps2)).norm(), 1e-6) << t;
    const Eigen::AngleAxisd turn(rotation(before.T_world_body).conjugate() * rotation(after.T_world_body));
    EXPECT_LT((turn.axis() * turn.angle() / (2 * h) - vector(b.turn_rate_radps)).norm(), 1e-6) << t;
    const Eigen::Vector3d dw = (vector(after.turn_rate_radps) - vector(before.turn_rate_radps)) / (2 * h);
    EXPECT_LT((dw - vector(b.turn_acceleration_radps2)).norm(), 1e-4 * (1 + dw.norm())) << t;
  }
}

TEST_P(Paths, HaveNoStepsInVelocityAccelerationAndTurnRate) {
  const auto poses = winding();
  const auto path = Trajectory::make(poses, GetParam());
  ASSERT_TRUE(path);
  const double h = 1e-8;
  for (std::size_t i = 1; i + 1 < poses.size(); ++i) {
    const BodyState before = path->at(poses[i].t_s - h, BenchTime()),
                    after = path->at(poses[i].t_s + h, BenchTime());
    EXPECT_LT((vector(before.velocity_mps) - vector(after.velocity_mps)).norm(), 1e-5);
    EXPECT_LT((vector(before.acceleration_mps2) - vector(after.acceleration_mps2)).norm(), 1e-4);
    EXPECT_LT((vector(before.turn_rate_radps) - vector(after.turn_rate_radps)).norm(), 1e-5);
  }
}

INSTANTIATE_TEST_SUITE_P(Trajectory, Paths, ::testing::Values(PathSpline::cubic, PathSpline::quintic),
                         [](const auto& i) { return i.param == PathSpline::cubic ? "Cubic" : "Quintic"; });

TEST(Trajectory, OfEvenMotionIsEvenMotion) {
  std::vector<TimedPose> poses;
  for (int i = 0; i < 6; ++i)
    poses.push_back(pose(i * 0.7, Eigen::Vector3d(1.4 * i, -0.7 * i, 0.07 * i),
                         Eigen::Quaterniond(Eigen::AngleAxisd(0.35 * i, Eigen::Vector3d::UnitZ()))));
  const auto path = Trajectory::make(poses);
  ASSERT_TRUE(path);
  for (const double t : {0.1, 1.0, 2.222, 3.4}) {
    const BodyState b = at(*path, t);
    EXPECT_LT((vector(b.velocity_mps) - Eigen::Vector3d(2, -1, 0.1)).norm(), 1e-12);
    EXPECT_LT(vector(b.acceleration_mps2).norm(), 1e-11);
    EXPECT_LT((vector(b.turn_rate_radps) - Eigen::Vector3d(0, 0, 0.5)).norm(), 1e-10);
  }
}

TEST(Trajectory, QuinticSetsOutAndStopsAtRest) {
  const auto poses = winding();
  const auto path = Trajectory::make(poses, PathSpline::quintic);
  ASSERT_TRUE(path);
  for (const double t : {poses.front().t_s + 1e-7, poses.back().t_s - 1e-7}) {
    EXPECT_LT(vector(at(*path, t).velocity_mps).norm(), 1e-4);
    EXPECT_LT(vector(at(*path, t).acceleration_mps2).norm(), 1e-3);
    EXPECT_LT(vector(at(*path, t).turn_rate_radps).norm(), 1e-4);
  }
}

TEST(Trajectory, RefusesWhatIsNoPath) {
  const auto one = pose(0, {0, 0, 0}, Eigen::Quaterniond::Identity());
  EXPECT_FALSE(Trajectory::make(std::vector{one}));
  const auto twice = Trajectory::make(std::vector{one, one});
  ASSERT_FALSE(twice);
  EXPECT_NE(twice.error().text().find("pose 2"), std::string::npos);
}

TEST(Trajectory, IsReadFromATable) {
  const auto file = std::filesystem::path(::testing::TempDir()) / "poses.csv";
  std::ofstream(file)
      << "# a way\nt_s, x_m, y_m, z_m, roll_deg, pitch_deg, yaw_deg\n0,1,2,3,0,0,90\n1,4,2,3,0,0,180\n";
  const auto poses = read_poses_csv(file);
  ASSERT_TRUE(poses) << poses.error().text();
  ASSERT_EQ(poses->size(), 2u);
  EXPECT_EQ((*poses)[1].T_world_body.position_m[0], 4);
  EXPECT_NEAR((*poses)[0].T_world_body.orientation_wxyz[3], std::sin(kPi / 4), 1e-15);
  std::ofstream(file) << "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n1,1,2,3,one,0,0,0\n";
  const auto bad = read_poses_csv(file);
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().text().find("poses.csv:3"), std::string::npos) << bad.error().text();
  EXPECT_NE(bad.error().text().find("qw"), std::string::npos);
}

}  // namespace
}  // namespace rigor
