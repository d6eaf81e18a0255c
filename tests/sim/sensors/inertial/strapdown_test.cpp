// What a simulated unit on a driving robot tells, integrated as a navigation computer does, against the way
// that the robot really went; and what its odometry makes of its wheels.
#include <gtest/gtest.h>

#include <cmath>

#include "sim/platform/skid_steer.h"
#include "sim/sensors/inertial/inertial_simulators.h"

namespace rigor {
namespace {

using Eigen::Isometry3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

const Duration kPeriod = milliseconds(2);
constexpr std::uint64_t kSamples = 5000;  // 10 s

Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

/// A robot that is told to go ahead, to turn, and to stand.
class Drive {
 public:
  explicit Drive(const SkidSteerConfig& config) : robot_(config, {1, 2, 0.3, 1, "robot"}, Ground(0.0)) {
    robot_.start(BenchTime());
    for (std::size_t i = 0; i < robot_.signals().size(); ++i) {
      if (robot_.signals()[i].name == "v") v_ = i;
      if (robot_.signals()[i].name == "w") w_ = i;
    }
  }
  /// In rising order.
  SampleProvider::Request at(std::uint64_t index) {
    const BenchTime t = BenchTime() + kPeriod * static_cast<std::int64_t>(index);
    if (index % 25 == 0) {
      const double t_s = (t - BenchTime()).seconds();
      EXPECT_TRUE(robot_.write(v_, t_s < 7 ? 0.8 : 0, t));
      EXPECT_TRUE(robot_.write(w_, t_s > 3 && t_s < 6 ? 0.6 : 0, t));
    }
    (void)robot_.read(0, t);
    const PlatformMotion m = robot_.motion_at(t);
    SampleProvider::Request r;
    r.index = index;
    r.t_capture = t;
    r.motion.body_count = 1;
    r.motion.body[0] = m.body;
    r.motion.count = m.joint_count;
    std::copy_n(m.joint.begin(), m.joint_count, r.motion.joint.begin());
    return r;
  }

 private:
  SkidSteer robot_;
  std::size_t v_ = 0, w_ = 0;
};

TEST(Strapdown, OfAUnitWithoutErrorsFollowsTheRobot) {
  Drive drive(SkidSteerConfig{});
  Isometry3d T_body_imu = Isometry3d::Identity();
  T_body_imu.translation() = Vector3d(0.3, -0.2, 0.4);
  T_body_imu.linear() = Eigen::AngleAxisd(0.8, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  const Carrier carrier = [&](const SampleProvider::Request& r, BenchTime t) {
    return carried_by(r.motion.body[0], t, T_body_imu);
  };
  ImuSimulator imu({"imu", 1, kPeriod, true}, {}, Earth(std::nullopt), carrier);
  Vector3d p, v, f_last, w_last;
  Quaterniond q;
  double worst_m = 0, worst_rad = 0, way_m = 0;
  for (std::uint64_t i = 0; i < kSamples; ++i) {
    const SampleProvider::Request r = drive.at(i);
    Sample s;
    ASSERT_TRUE(imu.capture(r, s));
    const Vector3d f = vector(s.as<ImuSample>()->specific_force_mps2);
    const Vector3d w = vector(s.as<ImuSample>()->angular_rate_radps);
    const SensorKinematics truth = carrier(r, r.t_capture);
    if (i == 0) {
      p = truth.T_world_sensor.translation();
      v = truth.velocity_mps;
      q = Quaterniond(truth.T_world_sensor.linear());
    } else {
      const double dt = kPeriod.seconds();
      const Vector3d turn = (w + w_last) / 2 * dt;
      const Vector3d a_last = q * f_last;
      if (turn.norm() > 0) q = q * Quaterniond(Eigen::AngleAxisd(turn.norm(), turn.normalized()));
      const Vector3d a = (a_last + q * f) / 2 - Vector3d(0, 0, 9.80665);
      p += v * dt + a * dt * dt / 2;
      v += a * dt;
      way_m += v.norm() * dt;
      worst_m = std::max(worst_m, (p - truth.T_world_sensor.translation()).norm());
      worst_rad = std::max(worst_rad, q.angularDistance(Quaterniond(truth.T_world_sensor.linear())));
    }
    f_last = f, w_last = w;
  }
  EXPECT_GT(way_m, 4);
  // Steps of acceleration between two samples cost the trapezoid a few µm/s each.
  EXPECT_LT(worst_m, 2e-3);
  EXPECT_LT(worst_rad, 1e-5);
}

TEST(Strapdown, OfARobotThatDoesNotSlipIsWhatItsOdometrySays) {
  SkidSteerConfig grips;
  grips.slip = grips.slip_per_slope = grips.sideslip = grips.icr_x_m = grips.icr_x_per_slope_m = 0;
  grips.icr_ratio = 1.5;
  grips.icr_ratio_per_radps = 0;
  Drive drive(grips);
  models::OdometryModel m;
  m.wheel_radius_m = grips.wheel_radius_m;
  m.track_m = grips.track_m * grips.icr_ratio;
  OdometrySimulator odometry({"odometry", 1, kPeriod, true}, m, wheels_of_joints(0, 1));
  Sample s;
  Isometry3d T_start, T_end;
  for (std::uint64_t i = 0; i < kSamples; ++i) {
    const SampleProvider::Request r = drive.at(i);
    ASSERT_TRUE(odometry.capture(r, s));
    const auto T = carried_by(r.motion.body[0], r.t_capture, Isometry3d::Identity()).T_world_sensor;
    (i == 0 ? T_start : T_end) = T;
  }
  const Isometry3d way = T_start.inverse() * T_end;
  const Odometry& o = *s.as<Odometry>();
  EXPECT_GT(way.translation().norm(), 3);
  EXPECT_NEAR(o.T_odom_base.position_m[0], way.translation().x(), 2e-3);
  EXPECT_NEAR(o.T_odom_base.position_m[1], way.translation().y(), 2e-3);
  const double yaw = 2 * std::atan2(o.T_odom_base.orientation_wxyz[3], o.T_odom_base.orientation_wxyz[0]);
  EXPECT_NEAR(yaw, std::atan2(way.linear()(1, 0), way.linear()(0, 0)), 1e-3);
}

}  // namespace
}  // namespace rigor
