#include "bench/live/estimate.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bench/analysis/localization_analysis.h"
#include "rt-core/numbers.h"

namespace rigor::live {
namespace {

constexpr std::size_t kMostTruths = 256, kMostTold = 256;
constexpr double kRadPerDeg = std::numbers::pi / 180;

template <class List>
std::optional<std::size_t> place_of(const List& names, std::string_view name) {
  const auto it = std::find(names.begin(), names.end(), name);
  return it == names.end() ? std::nullopt : std::optional(static_cast<std::size_t>(it - names.begin()));
}

}  // namespace

std::optional<LiveEstimate> LiveEstimate::of(const RunParts& parts) {
  const auto analysis = std::ranges::find(parts.rig.analyses, kLocalization, &AnalysisChoice::name);
  if (analysis == parts.rig.analyses.end()) return std::nullopt;
  const auto question = catch_config([&] { return localization_question(analysis->params); });
  if (!question) return std::nullopt;  // the bench has refused it before
  const auto named = [](const std::string& name) {
    return [&name](const auto& c) { return c->entry->name == name; };
  };
  const auto channel = std::ranges::find_if(parts.channels, named(question->truth));
  const auto sink = std::ranges::find_if(parts.sinks, named(question->estimate));
  if (channel == parts.channels.end() || sink == parts.sinks.end() || (*channel)->pair) return std::nullopt;
  LiveEstimate e;
  e.channel_ = static_cast<std::size_t>(channel - parts.channels.begin());
  e.sink_ = static_cast<std::uint32_t>(sink - parts.sinks.begin());
  const ChannelDescription& truth = (*channel)->source->describe();
  if (truth.kind == SampleKind::register_block) {
    e.x_ = place_of(truth.names, "x_m"), e.y_ = place_of(truth.names, "y_m");
    e.yaw_deg_ = place_of(truth.names, "yaw_deg");
    if (!e.x_ || !e.y_) return std::nullopt;
  } else if (truth.kind != SampleKind::pose) {
    return std::nullopt;
  }
  const auto& values = (*sink)->sink->describe().names;
  e.to_x_ = place_of(values, "x"), e.to_y_ = place_of(values, "y"), e.to_yaw_ = place_of(values, "yaw");
  e.to_sx_ = place_of(values, "sigma_x"), e.to_sy_ = place_of(values, "sigma_y");
  e.to_state_ = place_of(values, "state");
  if (!e.to_x_ || !e.to_y_) return std::nullopt;
  return e;
}

void LiveEstimate::truth(const Sample& sample) {
  PlanePose p;
  p.t_ns = sample.stamp.t_capture.ns();
  if (const auto* pose = sample.as<Pose>()) {
    p = plane_pose(p.t_ns, *pose);
  } else if (const auto* block = sample.as<RegisterBlock>()) {
    const auto value = [&](std::optional<std::size_t> i) {
      return i && *i < block->count ? block->value[*i] : kNaN;
    };
    p.x_m = value(x_), p.y_m = value(y_), p.yaw_rad = value(yaw_deg_) * kRadPerDeg;
  } else {
    return;
  }
  if (!std::isfinite(p.x_m + p.y_m)) return;
  if (!truth_.empty() && p.t_ns <= truth_.back().t_ns) truth_.clear();  // the run was begun anew
  if (truth_.size() == kMostTruths) truth_.erase(truth_.begin(), truth_.begin() + kMostTruths / 2);
  truth_.push_back(p);
}

void LiveEstimate::told(std::uint32_t sink, const Command& command) {
  if (sink != sink_) return;
  const auto value = [&](std::optional<std::size_t> i) {
    return i && *i < std::min<std::size_t>(command.count, command.value.size()) ? command.value[*i] : kNaN;
  };
  if (value(to_state_) == 0) return;  // it is searching
  const double sx = value(to_sx_), sy = value(to_sy_);
  Told t{{command.t_issue.ns(), value(to_x_), value(to_y_), value(to_yaw_)},
         std::sqrt((sx * sx + sy * sy) / 2)};
  if (!std::isfinite(t.pose.x_m + t.pose.y_m)) return;
  if (estimates_.size() == kMostTold) estimates_.pop_front();
  estimates_.push_back(t);
}

std::optional<LiveEstimate::At> LiveEstimate::next() {
  while (!estimates_.empty() && !truth_.empty() && truth_.back().t_ns >= estimates_.front().pose.t_ns) {
    const Told told = estimates_.front();
    estimates_.pop_front();
    const auto p = pose_at(truth_, told.pose.t_ns);
    if (!p) continue;
    const PlanePoseError error = pose_error(told.pose, *p);
    return At{BenchTime(told.pose.t_ns),
              p->x_m,
              p->y_m,
              error.along_m,
              error.across_m,
              error.yaw_rad,
              told.sigma_m};
  }
  return std::nullopt;
}

}  // namespace rigor::live
