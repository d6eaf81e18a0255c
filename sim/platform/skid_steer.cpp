#include "sim/platform/skid_steer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace rigor {
namespace {

constexpr double kGravity_mps2 = 9.80665;
constexpr double kDegPerRad = 180 / std::numbers::pi;
constexpr double kEvent_s = 0.5;
/// Below this rate of the wheels motors hold by their brakes and give way to no slope.
constexpr double kHold_radps = 0.1;
constexpr double kRest_radps = 1e-6;

enum Side : std::size_t { kLeft, kRight };
enum StatusBit : unsigned { kEnabled = 1, kMoving = 2, kLimited = 4, kFaulty = 8 };
enum Fault : std::int32_t { kNoFault, kTilted, kOffGround, kFlat };

enum RobotSignal : std::size_t {
  kLeftAngle,
  kRightAngle,
  kLeftRate,
  kRightRate,
  kStatus,
  kFault,
  kBattery,
  kX,
  kY,
  kZ,
  kRoll,
  kPitch,
  kYaw,
  kVelocity,
  kYawRate,
  kEnable,
  kV,
  kW,
  kLeftCommand,
  kRightCommand
};

std::array<Eigen::Vector2d, 4> corners(const SkidSteerConfig& c) {
  const double x = c.wheelbase_m / 2, y = c.track_m / 2;
  return {Eigen::Vector2d(x, y), Eigen::Vector2d(x, -y), Eigen::Vector2d(-x, y), Eigen::Vector2d(-x, -y)};
}

const std::vector<PlatformSignal>& table() {
  static const std::vector<PlatformSignal> all = [] {
    std::vector<PlatformSignal> t{{"left_angle", "rad"},   {"right_angle", "rad"},   {"left_rate", "rad/s"},
                                  {"right_rate", "rad/s"}, {"status", "", false, 1}, {"fault", "", false, 1},
                                  {"battery", "%"}};
    t.insert(t.end(), kTruthSignals.begin(), kTruthSignals.end());
    t.insert(t.end(), {{"yaw_rate_degps", "deg/s", false, 1e-4},
                       {"enable", "", true, 1},
                       {"v", "m/s", true},
                       {"w", "rad/s", true},
                       {"left", "rad/s", true},
                       {"right", "rad/s", true}});
    return t;
  }();
  return all;
}

}  // namespace

SkidSteer::SkidSteer(const SkidSteerConfig& config, const PlatformStart& start, Ground ground)
    : SignalPlatform(table()),
      model_{config, std::move(ground), Footprint(corners(config)),
             models::channel_key(start.seed, models::channel_id_from_name(start.name))},
      begin_(start),
      history_(model_, config.step) {
  if (model_.c.effective_track_m <= 0) model_.c.effective_track_m = config.track_m * config.icr_ratio;
  this->start(BenchTime(std::numeric_limits<std::int64_t>::max() / 4));
}

void SkidSteer::start(BenchTime t0) {
  const std::lock_guard lock(mutex_);
  State s;
  s.chassis = chassis_at_rest(model_.wheels, model_.ground, begin_.x_m, begin_.y_m, begin_.yaw_rad);
  last_ = t0;
  history_.start(t0, s, Command{});
}

/// Rates of the sides that a command asks for, within what the motors can.
std::array<double, 2> SkidSteer::Model::wanted_radps(const Command& told, bool& limited) const noexcept {
  std::array<double, 2> rate = told.rate_radps;
  limited = false;
  if (!told.rates) {
    const double v = std::clamp(told.v_mps, -c.max_speed_mps, c.max_speed_mps);
    const double w = std::clamp(told.w_radps, -c.max_turn_radps, c.max_turn_radps);
    limited = v != told.v_mps || w != told.w_radps;
    const double side = w * c.effective_track_m / 2;
    rate = {(v - side) / c.wheel_radius_m, (v + side) / c.wheel_radius_m};
  }
  const double most = c.max_speed_mps / c.wheel_radius_m;
  const double greatest = std::max(std::abs(rate[kLeft]), std::abs(rate[kRight]));
  if (greatest > most) {  // both sides alike, so that the curve stays the same
    limited = true;
    for (double& r : rate) r *= most / greatest;
  }
  for (double& r : rate)
    if (std::abs(r) * c.wheel_radius_m < c.dead_band_mps) r = 0;
  return rate;
}

/// Extra slip of a side: time goes in slots of half a second, and each may hold one event, a half wave.
double SkidSteer::Model::event_slip(std::int64_t k, std::size_t side) const noexcept {
  if (c.slip_events_per_s <= 0) return 0;
  const std::int64_t per_slot = std::max<std::int64_t>(1, std::llround(kEvent_s / c.step.seconds()));
  const auto words =
      models::draw_words(key, models::NoiseEffect::platform_slip, static_cast<std::uint64_t>(k / per_slot),
                         static_cast<std::uint32_t>(side));
  const double whether = words[0] * 0x1p-32, how_much = (words[1] + 0.5) * 0x1p-32;
  if (whether >= c.slip_events_per_s * kEvent_s) return 0;
  const double at = static_cast<double>(k % per_slot) / static_cast<double>(per_slot);
  return c.slip_event * how_much * std::sin(std::numbers::pi * at);
}

SkidSteer::State SkidSteer::Model::step(const State& from, const Command& told,
                                        std::int64_t k) const noexcept {
  State to = from;
  const double h = c.step.seconds(), r = c.wheel_radius_m;
  if (!told.enable) to.fault = kNoFault;
  const bool silent = c.command_timeout_s > 0 && static_cast<double>(k - told.k) * h >= c.command_timeout_s;
  std::array<double, 2> wanted = wanted_radps(told, to.limited);
  if (!told.enable || to.fault != kNoFault || silent) wanted = {0, 0};

  const double uphill = slope_ahead(from.chassis), to_left = slope_left(from.chassis);
  const double pull_mps2 = kGravity_mps2 * uphill;
  std::array<double, 2> rim_mps{};
  for (const std::size_t side : {kLeft, kRight}) {
    double& ramp = to.ramp_radps[side];
    const bool slower = std::abs(wanted[side]) < std::abs(ramp) || wanted[side] * ramp < 0;
    const double most = (slower ? c.braking_mps2 : c.acceleration_mps2) / r * h;
    ramp += std::clamp(wanted[side] - ramp, -most, most);
    const double holds = std::min(1.0, std::abs(ramp) / kHold_radps);
    const double aim = ramp - holds * c.droop_s * pull_mps2 / r;
    double& rate = to.rate_radps[side];
    rate = aim + (from.rate_radps[side] - aim) * std::exp(-h / c.time_constant_s);
    if (ramp == 0 && std::abs(rate) < kRest_radps) rate = 0;
    to.angle_rad[side] += 0.5 * h * (from.rate_radps[side] + rate);
    const double slip = std::clamp(
        c.slip + c.slip_per_slope * uphill * (rate < 0 ? -1.0 : 1.0) + event_slip(k, side), -0.5, 0.95);
    rim_mps[side] = r * rate * (1 - slip);
  }

  const double difference = rim_mps[kRight] - rim_mps[kLeft];
  const double ratio = c.icr_ratio + c.icr_ratio_per_radps * std::abs(difference) / c.track_m;
  ChassisSpeed speed;
  speed.turn_radps = difference / (c.track_m * ratio);
  speed.forward_mps = 0.5 * (rim_mps[kLeft] + rim_mps[kRight]);
  speed.left_mps = -(c.icr_x_m - c.icr_x_per_slope_m * uphill) * speed.turn_radps -
                   c.sideslip * to_left * std::abs(speed.forward_mps);
  bool on_ground = true;
  to.chassis = step_chassis(from.chassis, speed, c.suspension, wheels, ground, h, on_ground);

  // What the motors take: the pull of slope and soil over their efficiency; nothing comes back downhill.
  const double force_n =
      c.mass_kg * (pull_mps2 + kGravity_mps2 * c.rolling_resistance * (speed.forward_mps < 0 ? -1.0 : 1.0));
  to.energy_j += h * (c.idle_w + std::max(0.0, force_n * speed.forward_mps) / c.efficiency);

  to.trouble = kNoFault;
  if (std::abs(to.chassis.angle_rad[0]) > c.tip_roll_rad ||
      std::abs(to.chassis.angle_rad[1]) > c.tip_pitch_rad)
    to.trouble = kTilted;
  else if (!on_ground)
    to.trouble = kOffGround;
  else if (to.energy_j >= c.battery_wh * 3600)
    to.trouble = kFlat;
  // Told anew although the trouble goes on, it may drive itself out.
  if (told.enable && to.fault == kNoFault && to.trouble != from.trouble) to.fault = to.trouble;
  return to;
}

PlatformMotion SkidSteer::motion_at(BenchTime t) const noexcept {
  history_.keep_up(t, mutex_);
  const auto m = history_.at(t);
  const double h = model_.c.step.seconds();
  PlatformMotion out;
  out.body = body_between(m.before.chassis, m.after.chassis, h, m.since_s, t);
  out.joint_count = 2;
  for (const std::size_t side : {kLeft, kRight}) {
    const double a = (m.after.rate_radps[side] - m.before.rate_radps[side]) / h;
    out.joint[side] = {
        t, m.before.angle_rad[side] + m.since_s * (m.before.rate_radps[side] + 0.5 * a * m.since_s),
        m.before.rate_radps[side] + a * m.since_s};
  }
  return out;
}

const std::vector<std::string>& SkidSteer::joint_names() const {
  static const std::vector<std::string> names{"left", "right"};
  return names;
}

std::vector<PlatformPart> SkidSteer::parts() const {
  const SkidSteerConfig& c = model_.c;
  std::vector<PlatformPart> parts;
  const double clearance_m = c.wheel_radius_m * 0.75;
  PlatformPart hull;
  hull.name = "hull";
  hull.shape = PlatformPart::Shape::box;
  hull.size_m = {c.length_m, std::max(0.1, c.track_m - c.wheel_width_m),
                 std::max(0.05, c.height_m - clearance_m)};
  hull.T_parent_part.translation().z() = clearance_m + hull.size_m.z() / 2;
  hull.reflectance = {0.55, 0.32, 0.05, 0.6, 0.6, 0.5};
  parts.push_back(hull);
  const char* const names[] = {"wheel_front_left", "wheel_front_right", "wheel_rear_left",
                               "wheel_rear_right"};
  const auto at = corners(c);
  for (std::size_t i = 0; i < at.size(); ++i) {
    PlatformPart wheel;
    wheel.name = names[i];
    wheel.shape = PlatformPart::Shape::cylinder;
    wheel.size_m = {2 * c.wheel_radius_m, 2 * c.wheel_radius_m, c.wheel_width_m};
    wheel.T_parent_part.translation() = Eigen::Vector3d(at[i].x(), at[i].y(), c.wheel_radius_m);
    // Its axle, z of a cylinder, points to the left: turning forward is positive.
    wheel.T_parent_part.linear() =
        Eigen::AngleAxisd(-std::numbers::pi / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
    wheel.reflectance = {0.05, 0.05, 0.05, 0.06, 0.06, 0.07};
    wheel.moves = PlatformPart::Moves::turns;
    wheel.joint = i % 2 == 0 ? kLeft : kRight;
    parts.push_back(wheel);
  }
  return parts;
}

double SkidSteer::value(std::size_t signal) {
  const Command& told = history_.told();
  const State& s = history_.state();
  const PlatformMotion m = motion_at(last_);
  if (signal >= kX && signal <= kVelocity) return truth_value(signal - kX, m.body, s.chassis.angle_rad);
  switch (signal) {
    case kLeftAngle:
      return m.joint[kLeft].position_rad;
    case kRightAngle:
      return m.joint[kRight].position_rad;
    case kLeftRate:
      return m.joint[kLeft].rate_radps;
    case kRightRate:
      return m.joint[kRight].rate_radps;
    case kStatus: {
      const bool moving = s.rate_radps[kLeft] != 0 || s.rate_radps[kRight] != 0;
      const auto flag = [](bool is, StatusBit bit) { return is ? static_cast<unsigned>(bit) : 0u; };
      return flag(told.enable && s.fault == kNoFault, kEnabled) | flag(moving, kMoving) |
             flag(s.limited, kLimited) | flag(s.fault != kNoFault, kFaulty);
    }
    case kFault:
      return s.fault;
    case kBattery:
      return std::max(0.0, 100 * (1 - s.energy_j / (model_.c.battery_wh * 3600)));
    case kYawRate:
      return s.chassis.rate_radps[2] * kDegPerRad;
    case kEnable:
      return told.enable ? 1 : 0;
    case kV:
      return told.v_mps;
    case kW:
      return told.w_radps;
    case kLeftCommand:
    case kRightCommand:
      return told.rate_radps[signal - kLeftCommand];
    default:
      return std::numeric_limits<double>::quiet_NaN();
  }
}

bool SkidSteer::take(std::size_t signal, double value) {
  Command told = history_.told();
  switch (signal) {
    case kEnable:
      told.enable = value != 0;
      break;
    case kV:
    case kW:
      (signal == kV ? told.v_mps : told.w_radps) = value;
      told.rates = false;
      break;
    case kLeftCommand:
    case kRightCommand:
      told.rate_radps[signal - kLeftCommand] = value;
      told.rates = true;
      break;
    default:
      return false;
  }
  told.k = std::max<std::int64_t>(0, (last_ - history_.t0()) / history_.step());
  history_.command(last_, told);
  return true;
}

}  // namespace rigor
