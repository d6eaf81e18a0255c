#include "sim/platform/harvester.h"
#include "sim/world/pose.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace rigor {
namespace {

using C = HarvesterConfig;
constexpr std::size_t kAxes = C::kAxes;
constexpr double kDegPerRad = 180 / std::numbers::pi;
/// Heights of the head above a stem's foot between which it can cut.
constexpr double kLowest_m = -0.5, kHighest_m = 3;

enum Joint : std::size_t {
  kWheels,
  kSteer,
  kSlewJoint,
  kBoomJoint,
  kStickJoint,
  kTelescopeJoint,
  kHang,
  kRotateJoint,
  kGripJoint,
  kJoints
};
constexpr std::array<std::size_t, kAxes> kJointOf{kSlewJoint,      kBoomJoint,   kStickJoint,
                                                  kTelescopeJoint, kRotateJoint, kGripJoint};

enum StatusBit : unsigned {
  kEnabled = 1,
  kMoving = 2,
  kLimited = 4,
  kFaulty = 8,
  kFelled = 16,
  kFoundNone = 32
};
enum Fault : std::int32_t { kNoFault, kTilted, kOffGround };

enum MachineSignal : std::size_t {
  kWheelAngle,
  kWheelRate,
  kSteerAngle,
  kAxisTold,
  kStatus = kAxisTold + kAxes,
  kFault,
  kFelledCount,
  kX,
  kY,
  kZ,
  kRoll,
  kPitch,
  kYaw,
  kVelocity,
  kHeadX,
  kHeadY,
  kHeadZ,
  kHangAngle,
  kFelledX,
  kFelledY,
  kFelledYaw,
  kEnable,
  kV,
  kSteerTo,
  kAxisTo,
  kFell = kAxisTo + kAxes
};

/// Units of the crane's signals in what its axes count in.
double unit_of(std::size_t axis) { return axis == C::kTelescope || axis == C::kGrip ? 1.0 : 1 / kDegPerRad; }

std::array<Eigen::Vector2d, 4> corners(const C& c) {
  const double x = c.wheelbase_m / 2, y = c.track_m / 2;
  return {Eigen::Vector2d(x, y), Eigen::Vector2d(x, -y), Eigen::Vector2d(-x, y), Eigen::Vector2d(-x, -y)};
}

const std::vector<PlatformSignal>& table() {
  static const std::vector<PlatformSignal> all = [] {
    std::vector<PlatformSignal> t{
        {"wheel_angle", "rad"}, {"wheel_rate", "rad/s"},  {"steer", "deg"},        {"slew", "deg"},
        {"boom", "deg"},        {"stick", "deg"},         {"telescope", "m"},      {"rotate", "deg"},
        {"grip", ""},           {"status", "", false, 1}, {"fault", "", false, 1}, {"felled", "", false, 1}};
    t.insert(t.end(), kTruthSignals.begin(), kTruthSignals.end());
    for (const char* name : {"head_x_m", "head_y_m", "head_z_m"}) t.push_back({name, "m", false, 1e-4});
    t.insert(t.end(), {{"hang", "deg"},
                       {"felled_x_m", "m", false, 1e-4},
                       {"felled_y_m", "m", false, 1e-4},
                       {"felled_yaw_deg", "deg"},
                       {"enable", "", true, 1},
                       {"v", "m/s", true},
                       {"steer_to", "deg", true},
                       {"slew_to", "deg", true},
                       {"boom_to", "deg", true},
                       {"stick_to", "deg", true},
                       {"telescope_to", "m", true},
                       {"rotate_to", "deg", true},
                       {"grip_to", "", true},
                       {"fell", "", true, 1}});
    return t;
  }();
  return all;
}

BenchTime since_start(std::int64_t k, Duration step) { return BenchTime(0) + step * k; }

}  // namespace

Harvester::Harvester(const HarvesterConfig& config, const PlatformStart& start, Ground ground,
                     std::vector<Stem> stems)
    : SignalPlatform(table()),
      model_{config, std::move(ground), Footprint(corners(config))},
      begin_(start),
      history_(model_, config.step),
      log_(std::move(stems)) {
  this->start(BenchTime(std::numeric_limits<std::int64_t>::max() / 4));
}

void Harvester::start(BenchTime t0) {
  const std::lock_guard lock(mutex_);
  State s;
  Command told;
  s.chassis = chassis_at_rest(model_.wheels, model_.ground, begin_.x_m, begin_.y_m, begin_.yaw_rad);
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double at = model_.c.axis[i].start;
    s.axis[i].position_rad = s.goal[i] = told.to[i] = at;
  }
  log_.clear();
  last_cut_ = {};
  last_ = t0;
  history_.start(t0, s, told);
}

Harvester::State Harvester::Model::step(const State& from, const Command& told,
                                        std::int64_t k) const noexcept {
  State to = from;
  const double h = c.step.seconds();
  if (!told.enable) to.fault = kNoFault;
  const bool off = !told.enable || to.fault != kNoFault;
  const double v = std::clamp(told.v_mps, -c.max_speed_mps, c.max_speed_mps);
  const double aim = std::clamp(told.steer_rad, -c.max_steer_rad, c.max_steer_rad);
  to.limited = v != told.v_mps || aim != told.steer_rad;
  to.ramp_mps += std::clamp((off ? 0 : v) - to.ramp_mps, -c.acceleration_mps2 * h, c.acceleration_mps2 * h);
  to.speed_mps = to.ramp_mps + (from.speed_mps - to.ramp_mps) * std::exp(-h / c.time_constant_s);
  if (to.ramp_mps == 0 && std::abs(to.speed_mps) < 1e-7) to.speed_mps = 0;
  to.wheel_rad += 0.5 * h * (from.speed_mps + to.speed_mps) / c.wheel_radius_m;
  const double turned =
      off ? 0 : std::clamp(aim - to.steer_rad, -c.steer_rate_radps * h, c.steer_rate_radps * h);
  to.steer_rad += turned;
  to.steer_radps = turned / h;

  ChassisSpeed speed;
  speed.forward_mps = to.speed_mps * (1 - c.slip);
  speed.turn_radps = speed.forward_mps * std::tan(to.steer_rad) / c.wheelbase_m;
  speed.left_mps = speed.turn_radps * c.wheelbase_m / 2;  // the rear axle does not slip sideways
  bool on_ground = true;
  to.chassis = step_chassis(from.chassis, speed, c.suspension, wheels, ground, h, on_ground);

  // Profiles begin at the instant from which this step goes on.
  const BenchTime t = since_start(k, c.step);
  for (std::size_t i = 0; i < kAxes; ++i) {
    const CraneAxis& a = c.axis[i];
    const double goal = std::clamp(told.to[i], a.min, a.max);
    to.limited = to.limited || goal != told.to[i];
    if (off && !from.stopped)
      to.axis[i] = profile_to_rate(from.axis[i].at(t), t, 0, a.acceleration);
    else if (!off && (goal != from.goal[i] || from.stopped))
      to.axis[i] = profile_to_position(from.axis[i].at(t), t, goal, a.rate, a.acceleration);
    if (!off) to.goal[i] = goal;
  }
  to.stopped = off;

  to.trouble = kNoFault;
  if (std::abs(to.chassis.angle_rad[0]) > c.tip_roll_rad ||
      std::abs(to.chassis.angle_rad[1]) > c.tip_pitch_rad)
    to.trouble = kTilted;
  else if (!on_ground)
    to.trouble = kOffGround;
  if (told.enable && to.fault == kNoFault && to.trouble != from.trouble) to.fault = to.trouble;
  return to;
}

/// Profiles of `after` are those that are followed from `before` on.
double Harvester::axis_at(const History::Moment& m, std::size_t axis, BenchTime t,
                          double* rate) const noexcept {
  const std::int64_t t0 = history_.t0().ns();
  const auto s = m.after.axis[axis].at(BenchTime(std::max<std::int64_t>(0, t.ns() - t0)));
  if (rate) *rate = s.rate_radps;
  return s.position_rad;
}

PlatformMotion Harvester::motion_of(const History::Moment& m, BenchTime t) const noexcept {
  const double h = model_.c.step.seconds(), s = m.since_s;
  PlatformMotion out;
  out.body = body_between(m.before.chassis, m.after.chassis, h, s, t);
  out.joint_count = kJoints;
  const double r = model_.c.wheel_radius_m, a = (m.after.speed_mps - m.before.speed_mps) / h;
  out.joint[kWheels] = {t, m.before.wheel_rad + s * (m.before.speed_mps + 0.5 * a * s) / r,
                        (m.before.speed_mps + a * s) / r};
  out.joint[kSteer] = {t, m.before.steer_rad + s * m.after.steer_radps, m.after.steer_radps};
  for (std::size_t i = 0; i < kAxes; ++i) {
    JointState& j = out.joint[kJointOf[i]];
    j.t_ref = t;
    j.position_rad = axis_at(m, i, t, &j.rate_radps);
  }
  const JointState &boom = out.joint[kBoomJoint], &stick = out.joint[kStickJoint];
  out.joint[kHang] = {t, -(boom.position_rad + stick.position_rad), -(boom.rate_radps + stick.rate_radps)};
  return out;
}

PlatformMotion Harvester::motion_at(BenchTime t) const noexcept {
  history_.keep_up(t, mutex_);
  return motion_of(history_.at(t), t);
}

Eigen::Isometry3d Harvester::head_of(const PlatformMotion& m) const noexcept {
  const auto joint = [&](std::size_t j) { return m.joint[j].position_rad; };
  const double boom = joint(kBoomJoint), stick = boom + joint(kStickJoint);
  const double stick_m = model_.c.stick_m + joint(kTelescopeJoint);
  const double out_m = model_.c.boom_m * std::cos(boom) + stick_m * std::cos(stick);
  const double up_m = model_.c.boom_m * std::sin(boom) + stick_m * std::sin(stick) - model_.c.head_m;
  Eigen::Isometry3d T = isometry_of(m.body.T_world_body);
  const double slew = joint(kSlewJoint);
  T.translate(model_.c.foot_m + Eigen::Vector3d(out_m * std::cos(slew), out_m * std::sin(slew), up_m));
  T.rotate(Eigen::AngleAxisd(slew + joint(kRotateJoint), Eigen::Vector3d::UnitZ()));
  return T;
}

Eigen::Isometry3d Harvester::T_world_head(BenchTime t) const noexcept { return head_of(motion_at(t)); }

/// Under the lock. The tree falls away from the machine, along the crane.
void Harvester::fell(BenchTime t) {
  const PlatformMotion m = motion_of(history_.at(t), t);
  const Eigen::Vector3d head = head_of(m).translation();
  const double yaw_rad = std::remainder(
      history_.state().chassis.angle_rad[2] + m.joint[kSlewJoint].position_rad, 2 * std::numbers::pi);
  if (log_.cut({head.x(), head.y(), head.z() - kHighest_m, head.z() - kLowest_m, model_.c.reach_m}, yaw_rad,
               t))
    last_cut_ = {Cut::found, head.x(), head.y(), yaw_rad};
  else
    last_cut_.what = Cut::found_none;
}

bool Harvester::apply_felling(double x_m, double y_m, double yaw_rad, BenchTime t) noexcept {
  constexpr double kInfinite = std::numeric_limits<double>::infinity(), kRounding_m = 0.02;
  return log_.cut({x_m, y_m, -kInfinite, kInfinite, model_.c.reach_m + kRounding_m}, yaw_rad, t);
}

const std::vector<std::string>& Harvester::joint_names() const {
  static const std::vector<std::string> names{"wheels",    "steer", "slew",   "boom", "stick",
                                              "telescope", "hang",  "rotate", "grip"};
  return names;
}

std::vector<PlatformPart> Harvester::parts() const {
  const C& c = model_.c;
  using P = PlatformPart;
  const std::array<double, 6> yellow{0.62, 0.42, 0.05, 0.65, 0.65, 0.5},
      black{0.05, 0.05, 0.05, 0.06, 0.06, 0.07}, green{0.05, 0.2, 0.08, 0.3, 0.3, 0.2};
  std::vector<P> parts;
  const auto add = [&](P part) {
    parts.push_back(std::move(part));
    return static_cast<int>(parts.size()) - 1;
  };
  const auto make = [&](const char* name, int parent, const Eigen::Vector3d& at) {
    P p;
    p.name = name;
    p.parent = parent;
    p.T_parent_part.translation() = at;
    return p;
  };
  const auto box = [&](const char* name, int parent, const Eigen::Vector3d& at, const Eigen::Vector3d& size,
                       const std::array<double, 6>& colour) {
    P p = make(name, parent, at);
    p.shape = P::Shape::box;
    p.size_m = size;
    p.reflectance = colour;
    return add(p);
  };
  const auto moving = [&](const char* name, int parent, const Eigen::Vector3d& at, std::size_t joint,
                          const Eigen::Vector3d& axis, bool slides = false) {
    P p = make(name, parent, at);
    p.moves = slides ? P::Moves::slides : P::Moves::turns;
    p.joint = static_cast<int>(joint);
    p.axis = axis;
    return add(p);
  };
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ(), raises = -Eigen::Vector3d::UnitY();
  box("hull", -1, {0, 0, c.clearance_m + c.hull_height_m / 2},
      {c.length_m, c.width_m * 0.55, c.hull_height_m}, green);
  const double cabin_m = c.cabin_height_m - c.clearance_m - c.hull_height_m;
  // The frame of the cabin is in the middle of its roof, where scanners are fixed.
  const int cabin = add(make("cabin", -1, {c.cabin_x_m, 0, c.cabin_height_m}));
  box("cabin_walls", cabin, {0, 0, -cabin_m / 2}, {1.7, 1.6, cabin_m}, yellow);
  const char* const names[] = {"wheel_front_left", "wheel_front_right", "wheel_rear_left",
                               "wheel_rear_right"};
  const auto at = corners(c);
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector3d hub(at[i].x(), at[i].y(), c.wheel_radius_m);
    const char* const pivots[] = {"pivot_left", "pivot_right"};
    const int pivot = i < 2 ? moving(pivots[i], -1, hub, kSteer, up) : -1;
    P wheel = make(names[i], pivot, i < 2 ? Eigen::Vector3d(Eigen::Vector3d::Zero()) : hub);
    wheel.T_parent_part.linear() =
        Eigen::AngleAxisd(-std::numbers::pi / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
    wheel.shape = P::Shape::cylinder;
    wheel.size_m = {2 * c.wheel_radius_m, 2 * c.wheel_radius_m, c.wheel_width_m};
    wheel.reflectance = black;
    wheel.moves = P::Moves::turns;
    wheel.joint = kWheels;
    add(wheel);
  }
  const int slew = moving("slew", -1, c.foot_m, kSlewJoint, up);
  box("foot", slew, {0, 0, -0.3}, {0.6, 0.6, 0.6}, yellow);
  const int boom = moving("boom", slew, {0, 0, 0}, kBoomJoint, raises);
  box("boom_beam", boom, {c.boom_m / 2, 0, 0}, {c.boom_m, 0.3, 0.35}, yellow);
  const int stick = moving("stick", boom, {c.boom_m, 0, 0}, kStickJoint, raises);
  box("stick_beam", stick, {c.stick_m / 2, 0, 0}, {c.stick_m, 0.22, 0.25}, yellow);
  const int telescope = moving("telescope", stick, {c.stick_m, 0, 0}, kTelescopeJoint, {1, 0, 0}, true);
  box("telescope_beam", telescope, {-c.stick_m / 2, 0, 0}, {c.stick_m * 0.95, 0.14, 0.16}, black);
  const int hang = moving("hang", telescope, {0, 0, 0}, kHang, raises);
  const int head = moving("head", hang, {0, 0, -c.head_m}, kRotateJoint, up);
  box("head_frame", head, {-0.45, 0, 0.2}, {0.5, 0.7, 1.2}, yellow);
  // Jaws close about the head's origin.
  const int left = moving("jaw_left", head, {-0.2, 0.4, 0}, kGripJoint, -up);
  box("jaw_left_arm", left, {0.35, 0.1, 0}, {0.7, 0.08, 0.2}, black);
  const int right = moving("jaw_right", head, {-0.2, -0.4, 0}, kGripJoint, up);
  box("jaw_right_arm", right, {0.35, -0.1, 0}, {0.7, 0.08, 0.2}, black);
  return parts;
}

double Harvester::value(std::size_t signal) {
  const State& s = history_.state();
  const Command& told = history_.told();
  const PlatformMotion m = motion_of(history_.at(last_), last_);
  if (signal >= kAxisTold && signal < kAxisTold + kAxes)
    return m.joint[kJointOf[signal - kAxisTold]].position_rad / unit_of(signal - kAxisTold);
  if (signal >= kAxisTo && signal < kAxisTo + kAxes)
    return told.to[signal - kAxisTo] / unit_of(signal - kAxisTo);
  if (signal >= kX && signal <= kVelocity) return truth_value(signal - kX, m.body, s.chassis.angle_rad);
  switch (signal) {
    case kWheelAngle:
      return m.joint[kWheels].position_rad;
    case kWheelRate:
      return m.joint[kWheels].rate_radps;
    case kSteerAngle:
      return m.joint[kSteer].position_rad * kDegPerRad;
    case kStatus: {
      bool moving = s.speed_mps != 0 || s.steer_radps != 0;
      for (const std::size_t j : kJointOf) moving = moving || m.joint[j].rate_radps != 0;
      const auto flag = [](bool is, StatusBit bit) { return is ? static_cast<unsigned>(bit) : 0u; };
      return flag(told.enable && s.fault == kNoFault, kEnabled) | flag(moving, kMoving) |
             flag(s.limited, kLimited) | flag(s.fault != kNoFault, kFaulty) |
             flag(last_cut_.what == Cut::found, kFelled) |
             flag(last_cut_.what == Cut::found_none, kFoundNone);
    }
    case kFault:
      return s.fault;
    case kFelledCount:
      return static_cast<double>(log_.fellings().size());
    case kHeadX:
    case kHeadY:
    case kHeadZ:
      return head_of(m).translation()[static_cast<Eigen::Index>(signal - kHeadX)];
    case kHangAngle:
      return m.joint[kHang].position_rad * kDegPerRad;
    case kFelledX:
      return last_cut_.x_m;
    case kFelledY:
      return last_cut_.y_m;
    case kFelledYaw:
      return last_cut_.yaw_rad * kDegPerRad;
    case kEnable:
      return told.enable ? 1 : 0;
    case kV:
      return told.v_mps;
    case kSteerTo:
      return told.steer_rad * kDegPerRad;
    case kFell:
      return told.fell ? 1 : 0;
    default:
      return std::numeric_limits<double>::quiet_NaN();
  }
}

bool Harvester::take(std::size_t signal, double value) {
  Command told = history_.told();
  if (signal >= kAxisTo && signal < kAxisTo + kAxes) {
    told.to[signal - kAxisTo] = value * unit_of(signal - kAxisTo);
  } else if (signal == kEnable) {
    told.enable = value != 0;
  } else if (signal == kV) {
    told.v_mps = value;
  } else if (signal == kSteerTo) {
    told.steer_rad = value / kDegPerRad;
  } else if (signal == kFell) {
    const bool rises = value >= 0.5 && !told.fell;
    told.fell = value >= 0.5;
    if (rises && told.enable && history_.state().fault == kNoFault) fell(last_);
  } else {
    return false;
  }
  history_.command(last_, told);
  return true;
}

}  // namespace rigor
