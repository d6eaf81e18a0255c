#include "apps/forest-localization/drive_output.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <string>

#include "apps/forest-localization/rig_ports.h"

namespace rigor::forest {
namespace {}

DriveOutput::DriveOutput(const ConfigNode& n, const ApplicationPorts& ports, Period loop_period) {
  port_ = &find_output(n, ports);
  const auto& names = port_->describe().names;
  if (names.size() > values_.size()) throw n.error("sink", "expected a sink of at most 16 values");
  const ConfigNode steering = n.map_or_absent("steering");
  turns_by_angle_ = steering.present();
  const auto place = [&](const char* name) {
    const auto it = std::find(names.begin(), names.end(), name);
    if (it == names.end())
      throw n.error("sink", std::string("expected a sink with the values v [m/s] and ") +
                                (turns_by_angle_ ? "steer_to [deg]" : "w [rad/s]") + ", found no \"" +
                                std::string(name) + "\" among its values");
    return static_cast<std::size_t>(it - names.begin());
  };
  v_at_ = place("v");
  w_at_ = place(turns_by_angle_ ? "steer_to" : "w");
  if (turns_by_angle_) {
    wheelbase_m_ = steering.number("wheelbase_m", {.min = 0.01, .max = 50});
    max_steer_rad_ = steering.number("max_deg", {.min = 1, .max = 80}) * kRadPerDeg;
    steering.finish();
  }
  for (std::size_t i = 0; i < names.size(); ++i)
    if (names[i] == "enable") values_[i] = 1;
  count_ = names.size();
  every_ = read_every(n, loop_period);
  period_s_ = static_cast<double>(every_) * loop_period.seconds();
  PathFollowerConfig& c = follower_config_;
  c.speed_mps = n.number_or("speed_mps", 0.5, {.min = 0.01, .max = 20});
  c.max_turn_radps = n.number_or("max_turn_degps", 45, {.min = 1, .max = 360}) * kRadPerDeg;
  c.lookahead_m = n.number_or("lookahead_m", 1, {.min = 0.1, .max = 50});
  c.stop_within_m = n.number_or("stop_within_m", 0.15, {.min = 0.01, .max = 10});
  if (turns_by_angle_) c.spot_turn_rad = 2 * std::numbers::pi;  // it cannot turn on the spot
  n.finish();
}

void DriveOutput::send(const DriveCommand& command, BenchTime now) noexcept {
  values_[v_at_] = command.v_mps;
  if (!turns_by_angle_)
    values_[w_at_] = command.w_radps;
  else if (std::abs(command.v_mps) > 0.02)  // while it stands, the wheels stay where they are
    values_[w_at_] = std::clamp(std::atan(command.w_radps * wheelbase_m_ / command.v_mps), -max_steer_rad_,
                                max_steer_rad_) /
                     kRadPerDeg;
  (void)port_->send(now, std::span(values_).first(count_));  // a full ring is counted by the sink
}

}  // namespace rigor::forest
