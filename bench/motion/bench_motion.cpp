#include "bench/motion/bench_motion.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bench/motion/rate_fit.h"
#include "sensor-hal/types/orientation.h"
#include "sim/platform/platform.h"

namespace rigor {
namespace {

/// A body is not taken to go on for longer than this after its last report.
constexpr Duration kGoesOn = milliseconds(500);

using Quaternion = std::array<double, 4>;
Quaternion product(const Quaternion& a, const Quaternion& b) {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
          a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
          a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

/// The rate, in the body's axes, at which `from` turns into `to` within `s` seconds the short way round.
std::array<double, 3> turn_between(const Quaternion& from, const Quaternion& to, double s) {
  Quaternion d = product({from[0], -from[1], -from[2], -from[3]}, to);
  if (d[0] < 0)
    for (double& x : d) x = -x;
  const double sine = std::sqrt(d[1] * d[1] + d[2] * d[2] + d[3] * d[3]);
  const double k = (sine < 1e-9 ? 2 : 2 * std::atan2(sine, d[0]) / sine) / s;
  return {k * d[1], k * d[2], k * d[3]};
}

}  // namespace

Status BenchMotion::bind(std::size_t index, const JointBinding& binding, const InputPort& input) {
  const auto& names = input.description->names;
  const auto find = [&](const std::string& name) {
    return static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin());
  };
  Joint& joint = joints_[index];
  joint.port = input.port;
  joint.scale_rad = binding.scale_rad;
  joint.position_index = find(binding.position_name);
  joint.has_rate = !binding.rate_name.empty();
  joint.rate_index = joint.has_rate ? find(binding.rate_name) : 0;
  for (const auto& [name, at] : {std::pair{binding.position_name, joint.position_index},
                                 std::pair{joint.has_rate ? binding.rate_name : names[0], joint.rate_index}})
    if (at >= names.size())
      return fail(ErrorCode::bad_input, "simulation.joints." + binding.joint,
                  fmt::format("expected a register of channel {} ({}), got \"{}\"", binding.channel,
                              fmt::join(names, ", "), name));
  return {};
}

void BenchMotion::carry(std::size_t index, const WorldPlatform& platform) {
  bodies_[index].platform = platform;
  body_count_ = std::max(body_count_, static_cast<std::uint32_t>(index + 1));
}

void BenchMotion::stand(std::size_t index, const BodyState& start) {
  bodies_[index] = {};
  bodies_[index].start = start;
  body_count_ = std::max(body_count_, static_cast<std::uint32_t>(index + 1));
}

Status BenchMotion::follow(std::size_t index, const std::string& platform, const BodyState& start,
                           const InputPort& input) {
  Body& body = bodies_[index];
  body = {};
  body.port = input.port;
  body.start = start;
  body_count_ = std::max(body_count_, static_cast<std::uint32_t>(index + 1));
  if (input.description->kind == SampleKind::pose) return {};
  const auto& names = input.description->names;
  const char* const wanted[] = {"x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg"};
  for (std::size_t i = 0; i < 6; ++i) {
    const auto at = std::find(names.begin(), names.end(), wanted[i]);
    body.value_index[i] = at == names.end() ? kNone : static_cast<std::size_t>(at - names.begin());
    if (i < 2 && at == names.end())
      return fail(
          ErrorCode::bad_input, "simulation.platforms." + platform,
          fmt::format("expected values x_m and y_m (and z_m, roll_deg, pitch_deg, yaw_deg) of channel "
                      "{}, found {}",
                      input.name, fmt::join(names, ", ")));
  }
  return {};
}

Status BenchMotion::follow_fellings(std::size_t index, std::shared_ptr<Platform> model,
                                    const InputPort& input) {
  Body& body = bodies_[index];
  const auto& names = input.description->names;
  const char* const wanted[] = {"felled", "felled_x_m", "felled_y_m", "felled_yaw_deg"};
  for (std::size_t i = 0; i < 4; ++i) {
    const auto at = std::find(names.begin(), names.end(), wanted[i]);
    if (at == names.end())
      return fail(ErrorCode::bad_input, "simulation.platforms",
                  fmt::format("expected values felled, felled_x_m, felled_y_m and felled_yaw_deg of channel "
                              "{}, found {}",
                              input.name, fmt::join(names, ", ")));
    body.cuts_index[i] = static_cast<std::size_t>(at - names.begin());
  }
  body.cuts = std::move(model);
  body.cuts_port = input.port;
  body.cuts_known = 0;
  return {};
}

/// Captures that were asked for until now have found the tree standing, and measure it so, whenever a worker
/// comes to them: it is gone for those alone that are asked for later.
void BenchMotion::take_felling(Body& body, BenchTime t_cycle) noexcept {
  if (!body.cuts || body.cuts_port->status() != PortStatus::fresh || !body.cuts_port->sample()) return;
  const auto* block = body.cuts_port->sample()->as<RegisterBlock>();
  if (!block) return;
  std::array<double, 4> value{};
  for (std::size_t i = 0; i < 4; ++i) {
    if (body.cuts_index[i] >= block->count) return;
    value[i] = block->value[body.cuts_index[i]];
    if (!std::isfinite(value[i])) return;  // the machine does not know yet
  }
  if (value[0] == body.cuts_known) return;
  const bool more = value[0] > body.cuts_known;
  body.cuts_known = value[0];
  if (more)
    (void)body.cuts->apply_felling(value[1], value[2], value[3] * std::numbers::pi / 180,
                                   t_cycle + nanoseconds(1));
}

void BenchMotion::take_pose(Body& body) noexcept {
  if (!body.port || body.port->status() != PortStatus::fresh || !body.port->sample()) return;
  const Sample& sample = *body.port->sample();
  Report r{sample.stamp.t_capture, {}};
  if (const auto* pose = sample.as<Pose>()) {
    r.T_world_body = *pose;
  } else if (const auto* block = sample.as<RegisterBlock>()) {
    std::array<double, 6> value{};
    for (std::size_t i = 0; i < 6; ++i)
      if (body.value_index[i] < block->count) value[i] = block->value[body.value_index[i]];
    for (const double x : value)
      if (!std::isfinite(x)) return;  // the device does not know yet
    constexpr double kRadPerDeg = std::numbers::pi / 180;
    r.T_world_body.position_m = {value[0], value[1], value[2]};
    r.T_world_body.orientation_wxyz =
        from_roll_pitch_yaw(value[3] * kRadPerDeg, value[4] * kRadPerDeg, value[5] * kRadPerDeg);
  } else {
    return;
  }
  if (!body.history.empty() && r.t <= body.back(0).t)
    body.history.clear();  // a clock stepped back: begin anew
  body.history.push_newest(r);
}

BodyState BenchMotion::Body::at(BenchTime t) const noexcept {
  BodyState s = start;
  s.t_ref = t;
  const std::size_t size = history.size();
  if (size == 0) return s;
  // The span of two reports that holds t, or the last one.
  std::size_t n = 1;
  while (n + 1 < size && back(n).t > t) ++n;
  if (size == 1 || t < back(size - 1).t) {
    s.T_world_body = back(size == 1 ? 0 : size - 1).T_world_body;
    return s;
  }
  const Report &from = back(n), &to = back(n - 1);
  const double span_s = (to.t - from.t).seconds();
  BodyState b;
  b.t_ref = from.t;
  b.T_world_body = from.T_world_body;
  b.turn_rate_radps =
      turn_between(from.T_world_body.orientation_wxyz, to.T_world_body.orientation_wxyz, span_s);
  for (std::size_t i = 0; i < 3; ++i) {
    const double mean = velocity_mps(n - 1, i);
    // Acceleration by the spans around, and the velocity with which it leads from report to report.
    double a = 0;
    if (n >= 2)
      a = (velocity_mps(n - 2, i) - mean) / (0.5 * (back(n - 2).t - from.t).seconds());
    else if (n + 1 < size)
      a = (mean - velocity_mps(n, i)) / (0.5 * (to.t - back(n + 1).t).seconds());
    if (t > to.t) a = acceleration_mps2(i);
    b.acceleration_mps2[i] = a;
    b.velocity_mps[i] = mean - 0.5 * a * span_s;
  }
  if (t > to.t + kFitSpan && b.acceleration_mps2 != std::array<double, 3>{}) {
    const BenchTime ends = to.t + kFitSpan;
    const double since_s = (ends - b.t_ref).seconds();
    b.T_world_body = b.at(ends);
    for (std::size_t i = 0; i < 3; ++i) b.velocity_mps[i] += b.acceleration_mps2[i] * since_s;
    b.acceleration_mps2 = {};
    b.t_ref = ends;
  }
  if (t > to.t + kGoesOn) {  // silent for long: it stays where it was left
    b.T_world_body = b.at(to.t + kGoesOn);
    b.velocity_mps = b.acceleration_mps2 = b.turn_rate_radps = {};
    b.t_ref = t;
  }
  return b;
}

/// The mean velocity between report `later` and the one before, counted back from the newest.
double BenchMotion::Body::velocity_mps(std::size_t later, std::size_t axis) const noexcept {
  return (back(later).T_world_body.position_m[axis] - back(later + 1).T_world_body.position_m[axis]) /
         (back(later).t - back(later + 1).t).seconds();
}

double BenchMotion::Body::acceleration_mps2(std::size_t axis) const noexcept {
  return estimated_acceleration(history.size() - 1, [&](std::size_t k) {
    return RateAt{back(k + 1).t + (back(k).t - back(k + 1).t) / 2, velocity_mps(k, axis)};
  });
}

double BenchMotion::Joint::acceleration_radps2(std::size_t newest) const noexcept {
  if (!has_rate) return 0;
  return estimated_acceleration(newest + 1, [&](std::size_t k) {
    return RateAt{history[newest - k].t_ref, history[newest - k].rate_radps};
  });
}

JointState BenchMotion::Joint::at(BenchTime t) const noexcept {
  const std::size_t newest = history.size() - 1;
  std::size_t before = newest;
  while (before > 0 && history[before].t_ref > t) --before;
  JointState s = history[before];
  if (s.t_ref > t) return s;
  if (before == newest) {
    s.acceleration_radps2 = acceleration_radps2(newest);
    if (const BenchTime ends = s.t_ref + kFitSpan; s.acceleration_radps2 != 0 && t > ends)
      s = {ends, s.at(ends), s.rate_at(ends), 0};
    return s;
  }
  const JointState& after = history[before + 1];
  const double span_s = (after.t_ref - s.t_ref).seconds();
  // Rotary joints may wrap between two reports: take the short way round.
  constexpr double kTurn = 6.283185307179586;
  double step = after.position_rad - s.position_rad;
  while (step > kTurn / 2) step -= kTurn;
  while (step < -kTurn / 2) step += kTurn;
  if (after.t_ref - s.t_ref <= kFitSpan) {
    std::size_t last = before + 1;
    while (last < newest && history[last + 1].t_ref <= t + kFitSpan * 2 / 3) ++last;
    s.acceleration_radps2 = acceleration_radps2(last);
  }
  // Through both reports.
  s.rate_radps = step / span_s - 0.5 * s.acceleration_radps2 * span_s;
  return s;
}

void BenchMotion::update(BenchTime t_cycle) noexcept {
  for (std::uint32_t i = 0; i < body_count_; ++i) {
    take_pose(bodies_[i]);
    take_felling(bodies_[i], t_cycle);
  }
  for (std::uint32_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    if (!joint.port || joint.port->status() != PortStatus::fresh || !joint.port->sample()) continue;
    const auto* block = joint.port->sample()->as<RegisterBlock>();
    if (!block || joint.position_index >= block->count) continue;
    JointState s;
    s.t_ref = joint.port->sample()->stamp.t_capture;
    s.position_rad = block->value[joint.position_index] * joint.scale_rad;
    if (joint.has_rate && joint.rate_index < block->count)
      s.rate_radps = block->value[joint.rate_index] * joint.scale_rad;
    if (!joint.history.empty() && s.t_ref <= joint.history.back().t_ref)
      joint.history.clear();  // a clock stepped back: begin anew
    joint.history.push_newest(s);
  }
}

WorldMotion BenchMotion::motion_at(BenchTime t) const noexcept {
  WorldMotion motion;
  motion.count = count_;
  motion.body_count = body_count_;
  for (std::uint32_t i = 0; i < body_count_; ++i) {
    if (bodies_[i].platform.model)
      add_platform_motion(motion, bodies_[i].platform, i, t);
    else
      motion.body[i] = bodies_[i].at(t);
  }
  for (std::uint32_t i = 0; i < count_; ++i)
    if (!joints_[i].history.empty()) motion.joint[i] = joints_[i].at(t);
  return motion;
}

}  // namespace rigor
