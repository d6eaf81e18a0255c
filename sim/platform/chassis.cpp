#include "sim/platform/chassis.h"

#include <cmath>
#include <numbers>

namespace rigor {
namespace {

enum Angle : std::size_t { kRoll, kPitch, kYaw };

/// Velocity in the world of a chassis that goes so in its own axes. z is the springs' affair.
std::array<double, 2> level_velocity(const std::array<double, 3>& angle, double forward, double left) {
  const double cr = std::cos(angle[kRoll]), sr = std::sin(angle[kRoll]);
  const double cp = std::cos(angle[kPitch]), sp = std::sin(angle[kPitch]);
  const double cy = std::cos(angle[kYaw]), sy = std::sin(angle[kYaw]);
  return {forward * cy * cp + left * (cy * sp * sr - sy * cr),
          forward * sy * cp + left * (sy * sp * sr + cy * cr)};
}

/// Turn rate in the body's frame of angles that change so.
std::array<double, 3> turn_rate(const std::array<double, 3>& angle, const std::array<double, 3>& rate) {
  const double cr = std::cos(angle[kRoll]), sr = std::sin(angle[kRoll]);
  const double cp = std::cos(angle[kPitch]), sp = std::sin(angle[kPitch]);
  return {rate[kRoll] - rate[kYaw] * sp, rate[kPitch] * cr + rate[kYaw] * cp * sr,
          -rate[kPitch] * sr + rate[kYaw] * cp * cr};
}

std::array<double, 4> quaternion(const std::array<double, 3>& angle) {
  const double cr = std::cos(angle[kRoll] / 2), sr = std::sin(angle[kRoll] / 2);
  const double cp = std::cos(angle[kPitch] / 2), sp = std::sin(angle[kPitch] / 2);
  const double cy = std::cos(angle[kYaw] / 2), sy = std::sin(angle[kYaw] / 2);
  return {cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
          cr * cp * sy - sr * sp * cy};
}

}  // namespace

ChassisState chassis_at_rest(const Footprint& wheels, const Ground& ground, double x_m, double y_m,
                             double yaw_rad) {
  ChassisState s;
  const Footprint::Stand stand = wheels.stand(ground, x_m, y_m, yaw_rad);
  if (std::isfinite(stand.z_m)) s.ground = {stand.z_m, stand.roll_rad, stand.pitch_rad};
  s.position_m = {x_m, y_m, s.ground[0]};
  s.angle_rad = {s.ground[1], s.ground[2], yaw_rad};
  return s;
}

ChassisState step_chassis(const ChassisState& from, const ChassisSpeed& speed, const Suspension& suspension,
                          const Footprint& wheels, const Ground& ground, double step_s,
                          bool& on_ground) noexcept {
  ChassisState to = from;
  const double h = step_s;
  // Springs. Their forces are those at the beginning of the step; the damper takes the speed at its end.
  const double w = 2 * std::numbers::pi * suspension.frequency_hz, c = 2 * suspension.damping * w;
  const std::array<double, 3> at{from.position_m[2], from.angle_rad[kRoll], from.angle_rad[kPitch]};
  const std::array<double, 3> rate{from.velocity_mps[2], from.rate_radps[kRoll], from.rate_radps[kPitch]};
  std::array<double, 3> next{}, next_rate{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double pull = w * w * (from.ground[i] - at[i]) + c * from.ground_rate[i];
    next_rate[i] = (rate[i] + h * pull) / (1 + h * c);
    next[i] = at[i] + 0.5 * h * (rate[i] + next_rate[i]);
  }
  to.angle_rad[kRoll] = next[1], to.angle_rad[kPitch] = next[2];
  to.rate_radps[kRoll] = next_rate[1], to.rate_radps[kPitch] = next_rate[2];

  const double cr = std::cos(next[1]), sr = std::sin(next[1]), cp = std::cos(next[2]);
  to.rate_radps[kYaw] = (speed.turn_radps + next_rate[2] * sr) / (cp * cr);
  to.angle_rad[kYaw] += 0.5 * h * (from.rate_radps[kYaw] + to.rate_radps[kYaw]);
  const auto v = level_velocity(to.angle_rad, speed.forward_mps, speed.left_mps);
  to.velocity_mps = {v[0], v[1], next_rate[0]};
  for (std::size_t i = 0; i < 2; ++i)
    to.position_m[i] += 0.5 * h * (from.velocity_mps[i] + to.velocity_mps[i]);
  to.position_m[2] = next[0];

  const Footprint::Stand stand = wheels.stand(ground, to.position_m[0], to.position_m[1], to.angle_rad[kYaw]);
  on_ground = std::isfinite(stand.z_m) && std::isfinite(stand.roll_rad) && std::isfinite(stand.pitch_rad);
  to.ground_rate = {};
  if (!on_ground) return to;
  to.ground = {stand.z_m, stand.roll_rad, stand.pitch_rad};
  for (std::size_t i = 0; i < 3; ++i) to.ground_rate[i] = (to.ground[i] - from.ground[i]) / h;
  return to;
}

BodyState body_between(const ChassisState& before, const ChassisState& after, double step_s, double since_s,
                       BenchTime t) noexcept {
  BodyState b;
  b.t_ref = t;
  std::array<double, 3> angle{}, rate{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double a = (after.velocity_mps[i] - before.velocity_mps[i]) / step_s;
    b.acceleration_mps2[i] = a;
    b.velocity_mps[i] = before.velocity_mps[i] + a * since_s;
    b.T_world_body.position_m[i] =
        before.position_m[i] + since_s * (before.velocity_mps[i] + 0.5 * a * since_s);
    const double turn = (after.rate_radps[i] - before.rate_radps[i]) / step_s;
    rate[i] = before.rate_radps[i] + turn * since_s;
    angle[i] = before.angle_rad[i] + since_s * (before.rate_radps[i] + 0.5 * turn * since_s);
  }
  b.T_world_body.orientation_wxyz = quaternion(angle);
  b.turn_rate_radps = turn_rate(angle, rate);
  const auto w0 = turn_rate(before.angle_rad, before.rate_radps);
  const auto w1 = turn_rate(after.angle_rad, after.rate_radps);
  for (std::size_t i = 0; i < 3; ++i) b.turn_acceleration_radps2[i] = (w1[i] - w0[i]) / step_s;
  return b;
}

double slope_ahead(const ChassisState& s) noexcept { return -std::sin(s.angle_rad[kPitch]); }
double slope_left(const ChassisState& s) noexcept {
  return std::cos(s.angle_rad[kPitch]) * std::sin(s.angle_rad[kRoll]);
}

}  // namespace rigor
