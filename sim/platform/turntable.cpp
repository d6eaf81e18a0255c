#include "sim/platform/turntable.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor {
namespace {

constexpr double kRadPerDeg = 0.017453292519943295;
constexpr double kRadPerCount = kRadPerDeg * 1e-3;

/// Two's complement, so that a count beyond 32 bits rolls over as a counter does.
std::uint32_t rolled(double counts) noexcept {
  return static_cast<std::uint32_t>(static_cast<std::int64_t>(std::round(counts)));
}

enum Status : std::uint16_t {
  kEnabled = 1u << 0,
  kMoving = 1u << 1,
  kAtTarget = 1u << 2,
  kFault = 1u << 3,
  kLimited = 1u << 4
};
constexpr std::uint16_t kFaultMode = 1, kFaultTimeout = 2;

}  // namespace

TurntableProfile::State TurntableProfile::at(BenchTime t) const noexcept {
  State s{position_rad, rate_radps, 0, false};
  // Nanoseconds as a double are exact for 104 days, and good to a few ns for centuries.
  double left = t > t_start ? static_cast<double>((t - t_start).ns()) * 1e-9 : 0;
  for (const auto& p : piece) {
    if (p.duration_s <= 0) continue;
    const double dt = std::min(left, p.duration_s);
    s.position_rad += dt * (s.rate_radps + 0.5 * p.acceleration_radps2 * dt);
    s.rate_radps += p.acceleration_radps2 * dt;
    if (left < p.duration_s) {
      s.acceleration_radps2 = p.acceleration_radps2;
      s.moving = true;
      return s;
    }
    left -= dt;
  }
  // What remains of rounding when braking ends is no motion.
  if (std::fabs(s.rate_radps) < 1e-12) s.rate_radps = 0;
  s.position_rad += s.rate_radps * left;
  s.moving = s.rate_radps != 0;
  return s;
}

TurntableProfile profile_to_rate(const TurntableProfile::State& from, BenchTime t, double rate_radps,
                                 double max_acceleration_radps2) noexcept {
  TurntableProfile p;
  p.t_start = t;
  p.position_rad = from.position_rad;
  p.rate_radps = from.rate_radps;
  const double change = rate_radps - from.rate_radps;
  p.piece[0] = {std::fabs(change) / max_acceleration_radps2, std::copysign(max_acceleration_radps2, change)};
  return p;
}

TurntableProfile profile_to_position(const TurntableProfile::State& from, BenchTime t, double position_rad,
                                     double max_rate_radps, double max_acceleration_radps2) noexcept {
  const double a = max_acceleration_radps2;
  TurntableProfile p;
  p.t_start = t;
  p.position_rad = from.position_rad;
  p.rate_radps = from.rate_radps;
  // Which side of the target the table would come to rest on if it braked at once decides the direction of
  // the move. In that direction s everything below is positive but the first rate.
  const double rest = from.position_rad + from.rate_radps * std::fabs(from.rate_radps) / (2 * a);
  const double s = position_rad >= rest ? 1 : -1;
  const double v0 = s * from.rate_radps, way = s * (position_rad - from.position_rad);
  double cruise = max_rate_radps, cruise_s = 0;
  // Ways of the first piece, which ends at the cruising rate (from a contrary rate it may be negative), and
  // of the last.
  const double first_way = (v0 > cruise ? v0 * v0 - cruise * cruise : cruise * cruise - v0 * v0) / (2 * a);
  const double fixed_way = first_way + cruise * cruise / (2 * a);
  if (fixed_way <= way) {
    cruise_s = (way - fixed_way) / cruise;
  } else if (v0 <= cruise) {
    cruise = std::sqrt(std::max(0.0, a * way + 0.5 * v0 * v0));  // too short to reach the rate
    cruise = std::max(cruise, v0);                               // rounding alone could say less
  } else {
    cruise = v0;  // brakes all the way
  }
  p.piece[0] = {std::fabs(cruise - v0) / a, s * std::copysign(a, cruise - v0)};
  p.piece[1] = {cruise_s, 0};
  p.piece[2] = {cruise / a, -s * a};
  return p;
}

Turntable::Turntable(const TurntableConfig& config) : config_(config) {
  profile_.position_rad = config.start_rad;
  profile_.t_start = BenchTime(std::numeric_limits<std::int64_t>::min() / 4);
  last_ = profile_.t_start;
  publish(profile_);
}

std::int32_t Turntable::holding_s32(std::size_t at) const noexcept {
  return static_cast<std::int32_t>(std::uint32_t{holding_[at]} << 16 | holding_[at + 1]);
}

/// Starts a new profile when what the registers ask for has changed.
void Turntable::follow(BenchTime t) {
  const bool enabled = holding_[0] != 0;
  if (!enabled) fault_ = 0;
  if (enabled && holding_[1] > 1) fault_ = kFaultMode;
  Goal goal;
  limited_ = false;
  if (enabled && fault_ == 0) {
    const double wanted = holding_s32(4) * kRadPerCount;
    const double rate = std::clamp(wanted, -config_.max_rate_radps, config_.max_rate_radps);
    limited_ = rate != wanted;
    goal.position_mode = holding_[1] == 1;
    goal.rate_radps = goal.position_mode ? (rate == 0 ? config_.max_rate_radps : std::fabs(rate)) : rate;
    if (goal.position_mode) goal.position_rad = holding_s32(2) * kRadPerCount;
  }
  if (goal == goal_) return;
  goal_ = goal;
  const auto state = profile_.at(t);
  profile_ = goal.position_mode ? profile_to_position(state, t, goal.position_rad, goal.rate_radps,
                                                      config_.max_acceleration_radps2)
                                : profile_to_rate(state, t, goal.rate_radps, config_.max_acceleration_radps2);
  publish(profile_);
}

void Turntable::expire(BenchTime t) {
  const BenchTime when(expires_ns_.load(std::memory_order_relaxed));
  if (t <= when) return;
  fault_ = kFaultTimeout;
  follow(when);
  expires_ns_.store(kNever, std::memory_order_release);
}

std::array<std::uint16_t, Turntable::kInputCount> Turntable::inputs(BenchTime t) const {
  const auto s = profile_.at(t);
  const bool enabled = holding_[0] != 0 && fault_ == 0;
  const bool at_target =
      enabled && s.acceleration_radps2 == 0 &&
      (goal_.position_mode ? !s.moving && std::fabs(s.position_rad - goal_.position_rad) < 0.5 * kRadPerCount
                           : std::fabs(s.rate_radps - goal_.rate_radps) < 0.5 * kRadPerCount);
  std::uint16_t status = 0;
  if (enabled) status |= kEnabled;
  if (s.moving) status |= kMoving;
  if (at_target) status |= kAtTarget;
  if (fault_ != 0) status |= kFault;
  if (limited_) status |= kLimited;
  const double counts = s.position_rad / kRadPerCount;
  double angle = std::round(counts) - 360000.0 * std::floor((std::round(counts) + 180000.0) / 360000.0);
  if (angle >= 180000.0) angle -= 360000.0;
  const std::uint32_t position = rolled(counts), rate = rolled(s.rate_radps / kRadPerCount),
                      turn = rolled(angle);
  const auto high = [](std::uint32_t x) { return static_cast<std::uint16_t>(x >> 16); };
  const auto low = [](std::uint32_t x) { return static_cast<std::uint16_t>(x); };
  return {high(position), low(position), high(rate), low(rate), status, fault_, high(turn), low(turn)};
}

bool Turntable::read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out, BenchTime t) {
  const std::lock_guard lock(mutex_);
  last_ = std::max(last_, t);
  expire(last_);
  const auto copy = [&](std::span<const std::uint16_t> from) {
    if (std::size_t{address} + out.size() > from.size()) return false;
    std::copy_n(from.begin() + address, out.size(), out.begin());
    return true;
  };
  if (table == RegisterTable::holding_registers) return copy(holding_);
  if (table == RegisterTable::input_registers) return copy(inputs(last_));
  return false;
}

bool Turntable::write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                      BenchTime t) {
  const std::lock_guard lock(mutex_);
  last_ = std::max(last_, t);
  expire(last_);
  if (table != RegisterTable::holding_registers || std::size_t{address} + in.size() > holding_.size())
    return false;
  std::copy(in.begin(), in.end(), holding_.begin() + address);
  follow(last_);
  const bool watched = holding_[0] != 0 && fault_ == 0 && holding_[6] != 0;
  expires_ns_.store(watched ? (last_ + milliseconds(holding_[6])).ns() : kNever, std::memory_order_release);
  return true;
}

namespace {

enum TableSignal : std::size_t {
  kPosition,
  kRate,
  kAngle,
  kStatus,
  kFaultCode,
  kEnable,
  kMode,
  kTargetPosition,
  kTargetRate,
  kCommandTimeout
};

}  // namespace

const std::vector<SignalModel::Signal>& Turntable::signals() const {
  static const std::vector<Signal> all{{"position", "deg", false},
                                       {"rate", "deg/s", false},
                                       {"angle", "deg", false},
                                       {"status", "", false},
                                       {"fault", "", false},
                                       {"enable", "", true},
                                       {"mode", "", true},
                                       {"target_position", "deg", true},
                                       {"target_rate", "deg/s", true},
                                       {"command_timeout", "ms", true}};
  return all;
}

double Turntable::read(std::size_t signal, BenchTime t) {
  const std::lock_guard lock(mutex_);
  last_ = std::max(last_, t);
  expire(last_);
  const auto in = inputs(last_);
  switch (signal) {
    case kPosition:  // not from its register, which rolls over
      return profile_.at(last_).position_rad / kRadPerDeg;
    case kRate:
      return profile_.at(last_).rate_radps / kRadPerDeg;
    case kAngle:
      return static_cast<std::int32_t>(std::uint32_t{in[6]} << 16 | in[7]) * 1e-3;
    case kStatus:
      return in[4];
    case kFaultCode:
      return in[5];
    case kEnable:
      return holding_[0];
    case kMode:
      return holding_[1];
    case kTargetPosition:
      return holding_s32(2) * 1e-3;
    case kTargetRate:
      return holding_s32(4) * 1e-3;
    case kCommandTimeout:
      return holding_[6];
    default:
      return std::numeric_limits<double>::quiet_NaN();
  }
}

bool Turntable::write(std::size_t signal, double value, BenchTime t) {
  const double raw = std::round(signal == kTargetPosition || signal == kTargetRate ? value * 1e3 : value);
  std::array<std::uint16_t, 2> words{};
  if (signal == kEnable || signal == kMode || signal == kCommandTimeout) {
    if (!(raw >= 0 && raw <= 65535)) return false;
    words[0] = static_cast<std::uint16_t>(raw);
    const std::uint16_t address = signal == kEnable ? 0 : signal == kMode ? 1 : 6;
    return write(RegisterTable::holding_registers, address, std::span(words).first(1), t);
  }
  if ((signal != kTargetPosition && signal != kTargetRate) || !(raw >= -2147483648.0 && raw <= 2147483647.0))
    return false;
  const auto bits = static_cast<std::uint32_t>(static_cast<std::int32_t>(raw));
  words = {static_cast<std::uint16_t>(bits >> 16), static_cast<std::uint16_t>(bits)};
  return write(RegisterTable::holding_registers, signal == kTargetPosition ? 2 : 4, words, t);
}

void Turntable::publish(const TurntableProfile& p) noexcept {
  const auto n = published_.load(std::memory_order_relaxed);
  history_[n % kHistory].store({n, p});
  published_.store(n + 1, std::memory_order_release);
}

WorldMotion Turntable::motion_at(BenchTime t) const noexcept {
  TurntableProfile p;
  for (bool found = false; !found;) {
    const auto count = published_.load(std::memory_order_acquire);
    const auto oldest = count > kHistory - 1 ? count - (kHistory - 1) : 0;
    for (auto n = count; n-- > oldest;) {
      const auto entry = history_[n % kHistory].load();
      if (entry.number != n) break;  // overtaken: 63 commands came since `count` was read; start anew
      p = entry.profile;
      if ((found = p.t_start <= t || n == oldest)) break;
    }
  }
  // Nobody may have looked at the registers since the master fell silent.
  if (const BenchTime silent(expires_ns_.load(std::memory_order_acquire)); t > silent && p.t_start <= silent)
    p = profile_to_rate(p.at(silent), silent, 0, config_.max_acceleration_radps2);
  const auto s = p.at(t);
  WorldMotion m;
  m.count = 1;
  m.joint[0] = {t, s.position_rad, s.rate_radps};
  return m;
}

}  // namespace rigor
