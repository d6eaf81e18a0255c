#include "bench/expect/expectations.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>

#include "bench/expect/check.h"
#include "bench/expect/samples_due.h"
#include "sensor-hal/channel/typed_values.h"

namespace rigor {

using expect::Quantity;
using expect::Subject;

Expectations::~Expectations() = default;

void Expectations::begin(BenchTime t0) noexcept { t0_ = t0; }

void Expectations::Check::take_sample(Duration since_start) noexcept {
  const SampleLease& sample = port->sample();
  if (port->status() != PortStatus::fresh || !sample) return;
  if (sample->kind() == SampleKind::none) return;  // of a recording that has its stamp alone
  if (subject == Subject::value) {
    double v = kNaN;
    if (const auto* block = sample->as<RegisterBlock>()) {
      if (index < block->count) v = block->value[index];
    } else {
      std::array<double, 32> values{};
      const std::size_t n = std::min(values.size(), values_of_kind(kind).size());
      values_of_sample(*sample, std::span(values).first(n));
      if (index < n) v = values[index];
    }
    take(v, sample->stamp.t_capture, since_start);
  }
}

void Expectations::Check::add_estimate(const Command& c) noexcept {
  if (state && c.value[*state] == 0) return;  // it is searching
  if (estimate_count == estimates.size()) {   // the truth is silent: the oldest is dropped
    std::move(estimates.begin() + 1, estimates.end(), estimates.begin());
    --estimate_count;
  }
  estimates[estimate_count++] = {c.t_issue.ns(), c.value[*x], c.value[*y], yaw ? c.value[*yaw] : 0};
}

/// Estimates between two true poses are compared with the pose that is interpolated between these.
void Expectations::Check::take_truth(BenchTime t0) noexcept {
  const SampleLease& sample = port->sample();
  const Pose* pose = port->status() == PortStatus::fresh && sample ? sample->as<Pose>() : nullptr;
  if (!pose) return;
  if (truth_count == truths.size()) truths[0] = truths[1], --truth_count;
  truths[truth_count++] = plane_pose(sample->stamp.t_capture.ns(), *pose);
  const std::span<const PlanePose> known(truths.data(), truth_count);
  std::size_t done = 0;
  for (; done < estimate_count && estimates[done].t_ns <= known.back().t_ns; ++done) {
    const Duration since_start = BenchTime(estimates[done].t_ns) - t0;
    const auto truth = pose_at(known, estimates[done].t_ns);
    if (!truth || !in_window(since_start)) continue;
    const PlanePoseError error = pose_error(estimates[done], *truth);
    look(quantity == Quantity::position_m ? std::hypot(error.along_m, error.across_m)
                                          : std::abs(error.yaw_rad) * 180 / std::numbers::pi,
         since_start);
  }
  std::move(estimates.begin() + static_cast<std::ptrdiff_t>(done),
            estimates.begin() + static_cast<std::ptrdiff_t>(estimate_count), estimates.begin());
  estimate_count -= done;
}

void Expectations::command(const CommandPort& port, const Command& command) noexcept {
  const Duration since_start = command.t_issue - t0_;
  for (const auto& check : checks_) {
    if (check->commands != &port) continue;
    if (check->subject == Subject::estimate)
      check->add_estimate(command);
    else if (check->in_window(since_start) && check->index < command.count)
      check->take(command.value[check->index], command.t_issue, since_start);
  }
}

void Expectations::cycle(BenchTime t) noexcept {
  const Duration since_start = t - t0_;
  for (const auto& check : checks_) {
    Check& c = *check;
    if (!c.port) continue;
    if (c.subject == Subject::estimate) {
      c.take_truth(t0_);
      continue;
    }
    if (!c.in_window(since_start)) continue;
    if (!c.begun && c.from.ns() > 0) c.first = c.port->counters(), c.t_first = t;
    if (!c.begun && c.from.ns() == 0) c.t_first = t0_;
    c.begun = true;
    c.last = c.port->counters();
    c.t_last = t;
    c.take_sample(since_start);
    if (c.quantity != Quantity::age_ms && c.quantity != Quantity::age_p99_ms) continue;
    if (c.port->status() != PortStatus::fresh || !c.port->sample()) continue;
    const Duration age = t - c.port->sample()->stamp.t_capture;
    if (c.quantity == Quantity::age_ms)
      c.look(age.seconds() * 1e3, since_start);
    else
      c.ages.record(age);
  }
}

namespace {

/// Whether a recording says how it was: samples, statuses, commands, alarms and skipped cycles are in it.
bool in_recordings(Quantity q) {
  switch (q) {
    case Quantity::failed:
    case Quantity::late_commands:
    case Quantity::dropped:
    case Quantity::wake_p50_us:
    case Quantity::wake_p99_us:
    case Quantity::wake_max_us:
    case Quantity::cycle_p99_us:
    case Quantity::misses:
    case Quantity::late_answers:
    case Quantity::skipped_turns:
    case Quantity::restarts:
    case Quantity::answer_p99_ms:
      return false;
    default:
      return true;
  }
}

}  // namespace

void Expectations::Check::end(const RunEnd& run, BenchTime t0) {
  const auto us = [](Duration d) { return d.seconds() * 1e6; };
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  const std::uint64_t delivered = last.fresh + last.superseded - first.fresh - first.superseded;
  const auto due = [&]() -> std::uint64_t {
    const auto by = [&](BenchTime t) { return samples_due(t - t0, period, latency).value_or(0); };
    return by(t_last) - (from.ns() > 0 ? by(t_first) : 0);
  };
  if (run.of_recording && !in_recordings(quantity)) {
    result.told = false;
    return;
  }
  const auto sink = std::ranges::find(run.sinks, name, &RunEnd::Sink::name);
  const bool has_sink = sink != run.sinks.end();
  switch (quantity) {
    case Quantity::rate_hz: {
      if (!begun) break;
      const double span_s = period.ns() > 0 ? count(due()) * period.seconds() : (t_last - t_first).seconds();
      if (span_s > 0) judge(count(delivered) / span_s);
      break;
    }
    case Quantity::missing: {
      if (!begun) break;
      const std::uint64_t n = due(), behind = n > delivered ? n - delivered : 0;
      const std::uint64_t gaps = last.lost_samples - first.lost_samples;
      judge(count(std::max(gaps, behind > samples_at_edges(n) ? behind : 0)));
      break;
    }
    case Quantity::late:
      if (begun) judge(count(last.late_samples - first.late_samples));
      break;
    case Quantity::age_p99_ms:
      if (ages.count() > 0) judge(ages.percentile(0.99).seconds() * 1e3);
      break;
    case Quantity::failed:
      if (has_sink) judge(count(sink->failed));
      break;
    case Quantity::late_commands:
      if (has_sink) judge(count(sink->late));
      break;
    case Quantity::dropped:
      if (has_sink) judge(count(sink->dropped));
      break;
    case Quantity::wake_p50_us:
      judge(us(run.loop->wake_error.percentile(0.5)));
      break;
    case Quantity::wake_p99_us:
      judge(us(run.loop->wake_error.percentile(0.99)));
      break;
    case Quantity::wake_max_us:
      judge(us(run.loop->wake_error.max()));
      break;
    case Quantity::cycle_p99_us:
      judge(us(run.loop->cycle_time.percentile(0.99)));
      break;
    case Quantity::skipped:
      judge(count(run.loop ? run.loop->cycles_skipped : run.recorded_skipped));
      break;
    case Quantity::misses:
      judge(count(run.loop->misses.total));
      break;
    case Quantity::late_answers:
      if (run.application) judge(count(run.application->late));
      break;
    case Quantity::skipped_turns:
      if (run.application) judge(count(run.application->skipped));
      break;
    case Quantity::restarts:
      if (run.application) judge(count(run.application->restarts));
      break;
    case Quantity::answer_p99_ms:
      if (run.application && run.application->answer.count() > 0)
        judge(run.application->answer.percentile(0.99).seconds() * 1e3);
      break;
    case Quantity::alarm: {
      const auto came = std::ranges::find_if(run.alarms, [&](const RunEnd::Alarm& a) {
        return a.pair == name && in_window(seconds_from(a.t_s));
      });
      const bool is = came != run.alarms.end();
      result.looked_at = 1;
      result.least = result.most = is;
      result.outside = is != wanted_alarm;
      if (is && !wanted_alarm) result.first_s = came->t_s;
      break;
    }
    case Quantity::age_ms:
    case Quantity::value:
    case Quantity::per_s:
    case Quantity::position_m:
    case Quantity::yaw_deg:
      break;
  }
  result.holds = result.looked_at > 0 && result.outside == 0;
}

std::vector<Expected> Expectations::finish(const RunEnd& end) {
  std::vector<Expected> out;
  for (const auto& check : checks_) {
    check->end(end, t0_);
    out.push_back(check->result);
  }
  return out;
}

}  // namespace rigor
