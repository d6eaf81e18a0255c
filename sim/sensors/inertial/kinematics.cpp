#include "sim/sensors/inertial/kinematics.h"
#include "sim/world/pose.h"

#include <GeographicLib/Constants.hpp>
#include <GeographicLib/NormalGravity.hpp>
#include <cmath>
#include <numbers>

namespace rigor {
namespace {

Eigen::Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

}  // namespace

SensorKinematics carried_by(const BodyState& body, BenchTime t, const Eigen::Isometry3d& T_body_sensor) {
  const Eigen::Isometry3d T_world_body = isometry_of(body.at(t));
  const Eigen::Matrix3d R = T_world_body.linear();
  const double s = (t - body.t_ref).seconds();
  const Eigen::Vector3d alpha = vector(body.turn_acceleration_radps2);
  const Eigen::Vector3d omega = vector(body.turn_rate_radps) + alpha * s;
  const Eigen::Vector3d r = T_body_sensor.translation();
  SensorKinematics k;
  k.T_world_sensor.linear() = R * T_body_sensor.linear();
  k.T_world_sensor.translation() = T_world_body.translation() + R * r;
  k.velocity_mps = vector(body.velocity_mps) + vector(body.acceleration_mps2) * s + R * omega.cross(r);
  k.acceleration_mps2 = vector(body.acceleration_mps2) + R * (alpha.cross(r) + omega.cross(omega.cross(r)));
  k.rate_radps = T_body_sensor.linear().transpose() * omega;
  return k;
}

SensorKinematics differentiated(const Eigen::Isometry3d& before, const Eigen::Isometry3d& at,
                                const Eigen::Isometry3d& after, double h_s) {
  SensorKinematics k;
  k.T_world_sensor = at;
  const Eigen::Vector3d a = before.translation(), b = at.translation(), c = after.translation();
  k.velocity_mps = (c - a) / (2 * h_s);
  k.acceleration_mps2 = ((c - b) - (b - a)) / (h_s * h_s);
  const Eigen::Matrix3d turned = before.linear().transpose() * after.linear();
  const Eigen::AngleAxisd turn(turned);
  // In the axes of `before`; half of it further on they are those of `at`, and the axis stays where it is.
  k.rate_radps = turn.axis() * (turn.angle() / (2 * h_s));
  return k;
}

Earth::Earth(const std::optional<GeoOrigin>& origin) {
  if (!origin) return;
  const auto& normal = GeographicLib::NormalGravity::WGS84();
  const auto gravity = [&](double height_m) {
    double north = 0, up = 0;
    normal.Gravity(origin->latitude_deg, height_m, north, up);
    return -up;
  };
  at_origin_mps2_ = gravity(origin->height_m);
  per_m_ = (gravity(origin->height_m + 500) - gravity(origin->height_m - 500)) / 1000;
  radius_m_ = GeographicLib::Constants::WGS84_a() + origin->height_m;
  const double latitude = origin->latitude_deg * std::numbers::pi / 180;
  rate_radps_ = normal.AngularVelocity() * Eigen::Vector3d(0, std::cos(latitude), std::sin(latitude));
}

Earth::Earth(const std::optional<GeoOrigin>& origin, double gravity_mps2) : Earth(origin) {
  at_origin_mps2_ = gravity_mps2;
  per_m_ = radius_m_ = 0;
}

Eigen::Vector3d Earth::gravity_mps2(const Eigen::Vector3d& p) const {
  if (!(radius_m_ > 0)) return {0, 0, -at_origin_mps2_};
  // Up beside the origin, and how far above the ellipsoid the curved Earth leaves a point of the plane.
  const Eigen::Vector3d up = Eigen::Vector3d(p.x(), p.y(), radius_m_ + p.z()).normalized();
  const double height_m = p.z() + (p.x() * p.x() + p.y() * p.y()) / (2 * radius_m_);
  return -(at_origin_mps2_ + per_m_ * height_m) * up;
}

}  // namespace rigor
