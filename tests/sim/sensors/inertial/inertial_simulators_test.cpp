#include "sim/sensors/inertial/inertial_simulators.h"
#include "sim/world/pose.h"

#include <gtest/gtest.h>

#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>

namespace rigor {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr GeoOrigin kOrigin{50.4, 6.5, 600};
const Duration kPeriod = milliseconds(5);

InertialSpec ideal() { return {"imu", 1, kPeriod, true}; }

std::array<double, 3> array(const Vector3d& v) { return {v.x(), v.y(), v.z()}; }
Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

/// A body that goes around the origin, radius 3 m, at `turn`, its x along the way, speeding up by `alpha`.
BodyState circling(double angle, double turn, double alpha) {
  constexpr double kRadius = 3;
  BodyState b;
  b.t_ref = BenchTime(1'000'000'000);
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(angle + M_PI / 2, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = kRadius * Vector3d(std::cos(angle), std::sin(angle), 0);
  b.T_world_body = pose_of(T);
  const Vector3d along(-std::sin(angle), std::cos(angle), 0), out(std::cos(angle), std::sin(angle), 0);
  b.velocity_mps = array(kRadius * turn * along);
  b.acceleration_mps2 = array(kRadius * (alpha * along - turn * turn * out));
  b.turn_rate_radps = {0, 0, turn};
  b.turn_acceleration_radps2 = {0, 0, alpha};
  return b;
}
Carrier on_body(const Isometry3d& T_body_sensor) {
  return [T_body_sensor](const SampleProvider::Request& r, BenchTime t) {
    return carried_by(r.motion.body[0], t, T_body_sensor);
  };
}
SampleProvider::Request request_at(BenchTime t, const BodyState& body, std::uint64_t index = 0) {
  SampleProvider::Request r;
  r.index = index;
  r.t_capture = t;
  r.motion.body_count = 1;
  r.motion.body[0] = body;
  return r;
}
template <class T>
T captured(SampleProvider& provider, const SampleProvider::Request& request) {
  Sample s;
  EXPECT_TRUE(provider.capture(request, s));
  EXPECT_TRUE(s.as<T>());
  return *s.as<T>();
}

TEST(Imu, AtRestFeelsGravityUpwardsInItsOwnAxes) {
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitX()).toRotationMatrix();  // its y points up
  ImuSimulator imu(ideal(), {}, Earth(std::nullopt), on_body(T));
  const ImuSample s = captured<ImuSample>(imu, request_at({}, BodyState{}));
  EXPECT_NEAR(s.specific_force_mps2[0], 0, 1e-12);
  EXPECT_NEAR(s.specific_force_mps2[1], 9.80665, 1e-12);
  EXPECT_NEAR(s.specific_force_mps2[2], 0, 1e-12);
  EXPECT_EQ(s.angular_rate_radps, (std::array<double, 3>{}));
}

// A body that circles with a sensor on a lever arm is the same as a sensor that circles by itself on its own
// radius: what the lever arm adds is compared with the circle that it is.
TEST(Imu, OnALeverArmFeelsItsOwnCircle) {
  const double turn = 0.7, alpha = 0.4;
  Isometry3d T = Isometry3d::Identity();
  T.translation() = Vector3d(0.5, -1.2, 0.3);  // to the right: outwards
  T.linear() = Eigen::AngleAxisd(0.3, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  ImuSimulator imu(ideal(), {}, Earth(std::nullopt), on_body(T));
  const BodyState body = circling(0.9, turn, alpha);
  const ImuSample s = captured<ImuSample>(imu, request_at(body.t_ref, body));
  // In the body's axes, from the middle of the circle: (0.5, −4.2).
  const Vector3d r(0.5, -4.2, 0);
  const Vector3d a = Vector3d(-alpha * r.y(), alpha * r.x(), 0) - turn * turn * r + Vector3d(0, 0, 9.80665);
  const Vector3d expected = T.linear().transpose() * a;
  EXPECT_LT((vector(s.specific_force_mps2) - expected).norm(), 1e-12);
  EXPECT_LT((vector(s.angular_rate_radps) - T.linear().transpose() * Vector3d(0, 0, turn)).norm(), 1e-12);
}

TEST(Imu, FeelsWhatThePosesOfItsWayDifferentiateTo) {
  const BodyState body = circling(0.2, 0.7, 0);
  Isometry3d T = Isometry3d::Identity();
  T.translation() = Vector3d(0.5, -1.2, 0.3);
  const SensorKinematics direct = carried_by(body, body.t_ref, T);
  const double h = 0.01;
  const auto at = [&](double s) {  // the circle itself
    return carried_by(circling(0.2 + 0.7 * s, 0.7, 0), body.t_ref, T).T_world_sensor;
  };
  const SensorKinematics k = differentiated(at(-h), at(0), at(h), h);
  EXPECT_LT((k.velocity_mps - direct.velocity_mps).norm(), 1e-4);
  EXPECT_LT((k.acceleration_mps2 - direct.acceleration_mps2).norm(), 1e-4);
  EXPECT_LT((k.rate_radps - direct.rate_radps).norm(), 1e-9);
}

TEST(Imu, TellsHowItWasBeforeItsDelay) {
  models::ImuModel m;
  m.delay_s = 0.05;
  ImuSimulator late({"imu", 1, kPeriod, false}, m, Earth(std::nullopt), on_body(Isometry3d::Identity()));
  BodyState body = circling(0, 0.7, 2);
  const ImuSample s = captured<ImuSample>(late, request_at(body.t_ref, body));
  EXPECT_NEAR(s.angular_rate_radps[2], 0.7 - 0.05 * 2, 1e-12);
}

TEST(Earth, PullsAsTheEllipsoidDoes) {
  const Earth earth(kOrigin);
  // Somigliana's formula at sea level, less the gradient over 600 m.
  const double s2 = std::pow(std::sin(50.4 * M_PI / 180), 2);
  const double sea = 9.7803253359 * (1 + 0.00193185265241 * s2) / std::sqrt(1 - 0.00669437999014 * s2);
  const double g = earth.gravity_mps2(Vector3d::Zero()).norm();
  EXPECT_NEAR(g, sea - 600 * 3.086e-6, 2e-5);
  EXPECT_NEAR(earth.gravity_mps2({0, 0, 100}).norm(), g - 100 * 3.086e-6, 1e-6);
  // A plumb line 6371 m to the east leans by a thousandth.
  const Vector3d leaning = earth.gravity_mps2({6378.0, 0, 0});
  EXPECT_NEAR(leaning.x() / leaning.z(), 1e-3, 2e-7);
  EXPECT_NEAR(earth.rate_radps().norm(), 7.292115e-5, 1e-12);
  EXPECT_NEAR(std::atan2(earth.rate_radps().z(), earth.rate_radps().y()), 50.4 * M_PI / 180, 1e-12);
  EXPECT_EQ(Earth(kOrigin, 9.5).gravity_mps2({1000, 0, 50}), Vector3d(0, 0, -9.5));
}

TEST(Gnss, TellsWhereItsAntennaIs) {
  models::GnssModel m;
  m.antenna_m = {0, 0, 2};
  Isometry3d T = Isometry3d::Identity();
  T.translation() = Vector3d(1, 0, 0);
  GnssSimulator gnss({"gnss", 1, milliseconds(100), true}, m, kOrigin, on_body(T));
  BodyState body;
  Isometry3d at = Isometry3d::Identity();
  at.translation() = Vector3d(100, 200, 3);
  at.linear() = Eigen::AngleAxisd(M_PI / 2, Vector3d::UnitZ()).toRotationMatrix();
  body.T_world_body = pose_of(at);
  const NavFix fix = captured<NavFix>(gnss, request_at({}, body));
  const GeographicLib::LocalCartesian frame(kOrigin.latitude_deg, kOrigin.longitude_deg, kOrigin.height_m);
  double x = 0, y = 0, z = 0;
  frame.Forward(fix.latitude_deg, fix.longitude_deg, fix.height_m, x, y, z);
  EXPECT_LT((Vector3d(x, y, z) - Vector3d(100, 201, 5)).norm(), 1e-7);
  EXPECT_EQ(fix.status, FixStatus::fix);
}

TEST(Gnss, AddsItsErrorsAlongEastNorthAndUpAndClaimsThem) {
  models::GnssModel m;
  m.best.white_horizontal_m = 1;
  m.best.white_vertical_m = 3;
  const InertialSpec spec{"gnss", 1, milliseconds(100), false};
  GnssSimulator gnss(spec, m, kOrigin, on_body(Isometry3d::Identity()));
  models::GnssErrors errors(m, models::channel_key(1, models::channel_id_from_name("gnss")), spec.period);
  const GeographicLib::LocalCartesian frame(kOrigin.latitude_deg, kOrigin.longitude_deg, kOrigin.height_m);
  for (std::uint64_t i = 0; i < 20; ++i) {
    const NavFix fix = captured<NavFix>(gnss, request_at({}, BodyState{}, i));
    double x = 0, y = 0, z = 0;
    frame.Forward(fix.latitude_deg, fix.longitude_deg, fix.height_m, x, y, z);
    const auto e = errors.at(i, 0, 0);
    EXPECT_LT((Vector3d(x, y, z) - vector(e.enu_m)).norm(), 1e-7);
    EXPECT_EQ(fix.covariance_enu_m2, (std::array<double, 9>{1, 0, 0, 0, 1, 0, 0, 0, 9}));
  }
}

TEST(Gnss, LooksUpTheCanopyAboveItAndHasNoPlaceWithoutAFix) {
  models::GnssModel m;
  m.multipath_horizontal_m = 1;
  m.canopy_multipath = 3;
  Vector3d asked;
  GnssSimulator gnss({"gnss", 1, milliseconds(100), false}, m, kOrigin, on_body(Isometry3d::Identity()),
                     [&](const Vector3d& p) {
                       asked = p;
                       return 1.0;
                     });
  BodyState body;
  body.T_world_body.position_m = {7, 8, 9};
  EXPECT_NEAR(captured<NavFix>(gnss, request_at({}, body)).covariance_enu_m2[0], 9, 1e-9);
  EXPECT_EQ(asked, Vector3d(7, 8, 9));
  m.first_fix_s = 10;
  GnssSimulator cold({"gnss", 1, milliseconds(100), false}, m, kOrigin, on_body(Isometry3d::Identity()));
  const NavFix none = captured<NavFix>(cold, request_at({}, body));
  EXPECT_EQ(none.status, FixStatus::none);
  EXPECT_TRUE(std::isnan(none.latitude_deg));
}

TEST(OdometrySimulator, CountsTheJointsOfItsWheels) {
  models::OdometryModel m;
  m.wheel_radius_m = 0.2;
  m.track_m = 1;
  OdometrySimulator odometry({"odometry", 1, milliseconds(20), true}, m, wheels_of_joints(2, 1));
  SampleProvider::Request r;
  r.motion.count = 3;
  r.motion.joint[2] = {BenchTime(), 0, 5};  // left
  r.motion.joint[1] = {BenchTime(), 0, 7};
  Odometry o;
  for (r.index = 0; r.index <= 50; ++r.index) {
    r.t_capture = BenchTime() + milliseconds(20) * static_cast<std::int64_t>(r.index);
    o = captured<Odometry>(odometry, r);
  }
  EXPECT_NEAR(o.wheel_angle_rad[0], 5, 1e-9);
  EXPECT_NEAR(o.wheel_angle_rad[1], 7, 1e-9);
  EXPECT_NEAR(o.velocity_mps[0], 1.2, 1e-9);
  EXPECT_NEAR(o.turn_rate_radps[2], 0.4, 1e-9);
  EXPECT_NEAR(o.T_odom_base.position_m[0], 3 * std::sin(0.4), 1e-9);
  r.motion.count = 1;  // of a world without these joints
  EXPECT_EQ(captured<Odometry>(odometry, r).wheel_angle_rad, (std::array<double, 2>{}));
}

TEST(OdometrySimulator, OfAnEvenMotionGoesAsThatMotionGoes) {
  models::OdometryModel m;
  OdometrySimulator odometry({"odometry", 1, milliseconds(20), true}, m, wheels_of_motion(m, 0.8, -0.3));
  SampleProvider::Request r;
  r.t_start = BenchTime(5);
  r.t_capture = BenchTime(5) + seconds(1);
  const Odometry o = captured<Odometry>(odometry, r);
  EXPECT_NEAR(o.velocity_mps[0], 0.8, 1e-12);
  EXPECT_NEAR(o.turn_rate_radps[2], -0.3, 1e-12);
}

}  // namespace
}  // namespace rigor
