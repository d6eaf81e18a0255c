#include "sensor-hal/models/odometry/odometry_model.h"

#include <cmath>
#include <numbers>

#include "sensor-hal/models/markov_path.h"

namespace rigor::models {

Status check(const OdometryModel& m) {
  for (const auto& [field, value] : {std::pair{"wheel_radius_m", m.wheel_radius_m}, {"track_m", m.track_m}})
    if (!(value > 0) || !std::isfinite(value))
      return fail(ErrorCode::bad_input, field, "expected metres above zero, got " + std::to_string(value));
  if (!(m.ticks_per_turn >= 0) || !std::isfinite(m.ticks_per_turn))
    return fail(ErrorCode::bad_input, "ticks_per_turn",
                "expected a number that is not negative, got " + std::to_string(m.ticks_per_turn));
  return {};
}

OdometryDevice::OdometryDevice(const OdometryModel& model, PhiloxKey key, Duration period)
    : model_(model), period_s_(period.seconds()) {
  const auto z = normal_draws(key, NoiseEffect::odometry_device, 0, 0);
  for (std::size_t i = 0; i < 2; ++i)
    radius_m_[i] = model.wheel_radius_m * (1 + model.radius_error[i] + model.radius_error_sigma * z[i]);
  track_m_ = model.track_m * (1 + model.track_error + model.track_error_sigma * z[2]);
  const auto words = draw_words(key, NoiseEffect::odometry_device, 0, 1);
  for (std::size_t i = 0; i < 2; ++i) phase_[i] = NoiseMath<double>::unit_from_bits(words[i]);
}

double OdometryDevice::counted(std::size_t side, double angle_rad) const noexcept {
  if (!(model_.ticks_per_turn > 0)) return angle_rad;
  constexpr double kTurn = 2 * std::numbers::pi;
  // An encoder begins at zero wherever its first edge lies.
  return std::floor(angle_rad / kTurn * model_.ticks_per_turn + phase_[side]) * kTurn / model_.ticks_per_turn;
}

Odometry OdometryDevice::measure(std::uint64_t index, BenchTime t_start, const Wheels& wheels) noexcept {
  const bool goes_on = any_ && t_start == t_start_ && index >= last_index_;
  if (goes_on && index == last_index_) return last_;
  Odometry o;
  std::array<double, 2> way_m{};
  for (std::size_t i = 0; i < 2; ++i) {
    o.wheel_angle_rad[i] = counted(i, wheels.angle_rad[i]);
    const double before = counted(i, wheels.angle_rad[i] - wheels.rate_radps[i] * period_s_);
    o.wheel_rate_radps[i] = (o.wheel_angle_rad[i] - before) / period_s_;
    if (goes_on) way_m[i] = radius_m_[i] * (o.wheel_angle_rad[i] - last_.wheel_angle_rad[i]);
  }
  if (!goes_on) x_m_ = y_m_ = yaw_rad_ = way_m_ = turned_rad_ = 0;
  const double way = (way_m[0] + way_m[1]) / 2, turn = (way_m[1] - way_m[0]) / track_m_;
  const auto step = along_circle(way, turn);
  x_m_ += std::cos(yaw_rad_) * step[0] - std::sin(yaw_rad_) * step[1];
  y_m_ += std::sin(yaw_rad_) * step[0] + std::cos(yaw_rad_) * step[1];
  yaw_rad_ = std::remainder(yaw_rad_ + turn, 2 * std::numbers::pi);
  way_m_ += std::abs(way);
  turned_rad_ += std::abs(turn);

  o.T_odom_base = {{x_m_, y_m_, 0}, {std::cos(yaw_rad_ / 2), 0, 0, std::sin(yaw_rad_ / 2)}};
  const double left_mps = radius_m_[0] * o.wheel_rate_radps[0],
               right_mps = radius_m_[1] * o.wheel_rate_radps[1];
  o.velocity_mps = {(left_mps + right_mps) / 2, 0, 0};
  o.turn_rate_radps = {0, 0, (right_mps - left_mps) / track_m_};
  const auto square = [](double v) { return v * v; };
  const double position = square(model_.position_per_m * way_m_);
  const double yaw = square(model_.yaw_rad_per_m * way_m_) + square(model_.yaw_per_rad * turned_rad_);
  o.pose_variance = {position, position, 0, 0, 0, yaw};
  o.twist_variance = {square(model_.speed_mps), 0, 0, 0, 0, square(model_.turn_rate_radps)};
  any_ = true;
  last_index_ = index;
  t_start_ = t_start;
  last_ = o;
  return o;
}

}  // namespace rigor::models
