#include "apps/forest-localization/odometry_input.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "apps/forest-localization/rig_ports.h"
#include "apps/forest-localization/statistics.h"
#include "sensor-hal/types/orientation.h"

namespace rigor::forest {

OdometryInput::OdometryInput(const ConfigNode& n, const ApplicationPorts& ports) {
  const InputPort& in =
      find_input(n, ports, {SampleKind::odometry, SampleKind::register_block}, "odometry or registers");
  port_ = in.port;
  if (in.description->kind == SampleKind::register_block) find_registers(n, *in.description);
  n.finish();
}

void OdometryInput::find_registers(const ConfigNode& n, const ChannelDescription& description) {
  const auto& names = description.names;
  steered_ = std::find(names.begin(), names.end(), "wheel_angle") != names.end();
  for (std::size_t side = 0; side < 2; ++side) {
    const char* name =
        steered_ ? (side == 0 ? "wheel_angle" : "steer") : (side == 0 ? "left_angle" : "right_angle");
    const auto it = std::find(names.begin(), names.end(), name);
    if (it == names.end())
      throw n.error("channel",
                    "expected registers with left_angle and right_angle in rad, or wheel_angle in rad and "
                    "steer in deg, found no \"" +
                        std::string(name) + "\" among them");
    register_[side] = static_cast<std::size_t>(it - names.begin());
  }
  wheel_radius_m_ = n.number("wheel_radius_m", {.min = 0.001, .max = 10});
  if (steered_)
    wheelbase_m_ = n.number("wheelbase_m", {.min = 0.01, .max = 50});
  else
    track_m_ = n.number("track_m", {.min = 0.01, .max = 20});
}

bool OdometryInput::take() noexcept {
  const Sample* sample = fresh_sample(port_);
  if (!sample) return false;
  const BenchTime t = sample->stamp.t_capture;
  if (const auto* o = sample->as<Odometry>()) {
    add(*o, t);
  } else if (const auto* r = sample->as<RegisterBlock>()) {
    if (register_[0] >= r->count || register_[1] >= r->count) return false;
    const double first = r->value[register_[0]], second = r->value[register_[1]];
    if (steered_)
      add_steered(first, second * kRadPerDeg);
    else
      add_sides(first, second);
  } else {
    return false;
  }
  t_ = t;
  seen_ = true;
  return true;
}

void OdometryInput::add(const Odometry& o, BenchTime t) noexcept {
  const std::array<double, 3> now{o.T_odom_base.position_m[0], o.T_odom_base.position_m[1],
                                  yaw_of(o.T_odom_base.orientation_wxyz)};
  if (seen_) {
    const double dx = now[0] - previous_[0], dy = now[1] - previous_[1],
                 turn = wrapped_rad(now[2] - previous_[2]);
    // The chord of a circle; its length is signed by the heading in its middle.
    const double heading = previous_[2] + turn / 2;
    const double along = dx * std::cos(heading) + dy * std::sin(heading);
    const double half = turn / 2;
    const double way = along * (std::abs(half) < 1e-4 ? 1 : half / std::sin(half));
    const double dt_s = std::max((t - t_).seconds(), 1e-3);
    if (std::abs(way) < 0.5 + 5 * dt_s) way_m_ += way, turn_rad_ += turn;  // else it began anew
  }
  previous_ = now;
}

void OdometryInput::add_sides(double left_rad, double right_rad) noexcept {
  if (seen_) {
    way_m_ += wheel_radius_m_ * (left_rad - previous_[0] + right_rad - previous_[1]) / 2;
    turn_rad_ += wheel_radius_m_ * (right_rad - previous_[1] - left_rad + previous_[0]) / track_m_;
  }
  previous_ = {left_rad, right_rad, 0};
}

void OdometryInput::add_steered(double wheel_rad, double steer_rad) noexcept {
  if (seen_) {
    // A curve of the angle that the front wheels had on the way between two reports.
    const double way = wheel_radius_m_ * (wheel_rad - previous_[0]);
    way_m_ += way;
    turn_rad_ += way * std::tan((previous_[1] + steer_rad) / 2) / wheelbase_m_;
  }
  previous_ = {wheel_rad, steer_rad, 0};
}

}  // namespace rigor::forest
