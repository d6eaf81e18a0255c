#include "cli/bench_motion.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

namespace rigor {

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

void BenchMotion::update() noexcept {
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
    if (joint.size > 0 && s.t_ref <= joint.history[joint.newest].t_ref)
      joint.size = 0;  // a clock stepped back: begin anew
    joint.newest = joint.size == 0 ? 0 : (joint.newest + 1) % kHistory;
    joint.history[joint.newest] = s;
    joint.size = std::min(joint.size + 1, kHistory);
  }
}

WorldMotion BenchMotion::motion_at(BenchTime t) const noexcept {
  WorldMotion motion;
  motion.count = count_;
  for (std::uint32_t i = 0; i < count_; ++i) {
    const Joint& joint = joints_[i];
    if (joint.size == 0) continue;
    const JointState* after = nullptr;
    const JointState* before = &joint.history[joint.newest];
    for (std::size_t k = 1; k < joint.size && before->t_ref > t; ++k) {
      after = before;
      before = &joint.history[(joint.newest + kHistory - k) % kHistory];
    }
    motion.joint[i] = *before;
    if (after && before->t_ref <= t && after->t_ref > before->t_ref) {
      // Rotary joints may wrap between two reports: take the short way round.
      constexpr double kTurn = 6.283185307179586;
      double step = after->position_rad - before->position_rad;
      while (step > kTurn / 2) step -= kTurn;
      while (step < -kTurn / 2) step += kTurn;
      motion.joint[i].rate_radps = step / (after->t_ref - before->t_ref).seconds();
    }
  }
  return motion;
}

}  // namespace rigor
