#include "drivers/aravis/exposure_schedule.h"

#include <algorithm>

namespace rigor {
namespace {

constexpr std::size_t kMostTriggers = 16;

}  // namespace

void ExposureSchedule::start(DeviceTime now) {
  running_ = true;
  index_ = 0;
  triggers_.clear();
  sensor_free_ = now;
  run_freely_from(now);
  if (line_.period.ns() > 0) next_edge_ = edge_from(now);
}

void ExposureSchedule::stop() {
  running_ = false;
  triggers_.clear();
}

void ExposureSchedule::run_freely_from(DeviceTime t) {
  if (settings_.period.ns() <= 0) return;
  zero_ = on_clock_ ? DeviceTime(0) : t;
  next_grid_ = settings_.period.first_index_from(t - zero_);
}

void ExposureSchedule::set(const Settings& settings, DeviceTime now) {
  if (settings == settings_) return;
  const bool other_source =
      settings.trigger != settings_.trigger || settings.falling_edge != settings_.falling_edge;
  // The next exposure keeps its distance from the last one, in the new period.
  const bool exposed = running_ && index_ > 0 && settings_.period.ns() > 0;
  const DeviceTime last = exposed ? grid(next_grid_ - 1) : now;
  settings_ = settings;
  if (!running_) return;
  if (other_source) {
    triggers_.clear();
    if (line_.period.ns() > 0) next_edge_ = edge_from(now);
  }
  run_freely_from(std::max({exposed ? last + settings_.period : now, sensor_free_, now}));
}

bool ExposureSchedule::software_trigger(DeviceTime now) {
  if (!running_ || settings_.trigger != Trigger::software || triggers_.size() >= kMostTriggers) {
    ++counters_.triggers_refused;
    return false;
  }
  ++counters_.triggers;
  triggers_.push_back(now + settings_.delay);
  return true;
}

DeviceTime ExposureSchedule::edge(std::int64_t k) const {
  const Duration half(settings_.falling_edge ? line_.period.ns() / 2 : 0);
  return DeviceTime(line_.phase.ns() % line_.period.ns()) + half + line_.period * k;
}

std::int64_t ExposureSchedule::edge_from(DeviceTime t) const {
  return (t - edge(0) - nanoseconds(1)) / line_.period + 1;
}

bool ExposureSchedule::line_is_high(DeviceTime now) const {
  if (line_.period.ns() == 0) return false;
  const Duration since = now - (DeviceTime(0) + line_.phase);
  return since - line_.period * (since / line_.period) < line_.period / 2;
}

DeviceTime ExposureSchedule::next() const {
  if (!running_) return DeviceTime::never();
  switch (settings_.trigger) {
    case Trigger::free_run:
      return settings_.period.ns() > 0 ? grid(next_grid_) : DeviceTime::never();
    case Trigger::software:
      return triggers_.empty() ? DeviceTime::never() : std::max(triggers_.front(), sensor_free_);
    case Trigger::line:
      return line_.period.ns() > 0 ? edge(next_edge_) + settings_.delay : DeviceTime::never();
  }
  return DeviceTime::never();
}

std::optional<ExposureSchedule::Exposure> ExposureSchedule::begin(DeviceTime now, Duration exposure) {
  DeviceTime start = next();
  if (start > now) return std::nullopt;
  std::int64_t behind = 0;
  switch (settings_.trigger) {
    case Trigger::free_run:
      behind = (now - zero_) / settings_.period - next_grid_;
      next_grid_ += behind;
      start = grid(next_grid_++);
      break;
    case Trigger::software:
      triggers_.pop_front();
      break;
    case Trigger::line:
      // Edges that nobody came to look at in time are past.
      behind = edge_from(now - settings_.delay + nanoseconds(1)) - 1 - next_edge_;
      next_edge_ += behind;
      start = edge(next_edge_++) + settings_.delay;
      ++counters_.line_edges;
      break;
  }
  counters_.skipped += static_cast<std::uint64_t>(behind);
  index_ += static_cast<std::uint64_t>(behind);
  sensor_free_ = start + exposure;
  if (settings_.trigger == Trigger::line) {
    const std::int64_t free = std::max(next_edge_, edge_from(sensor_free_ - settings_.delay));
    counters_.line_missed += static_cast<std::uint64_t>(free - next_edge_);
    next_edge_ = free;
  }
  return Exposure{index_++, start};
}

}  // namespace rigor
