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

Expectations::Expectations() : board_(std::make_unique<Board>()) {}
Expectations::~Expectations() = default;

void Expectations::begin(BenchTime t0) noexcept {
  t0_ = t0;
  for (const auto& check : checks_) {
    check->seen.t0 = t0;
    if (check->safe_state) check->safe_state->begin(t0), check->faults_on = 0;
  }
}

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

bool Expectations::Check::is_wrong() const noexcept {
  if (wrong.fault) return faults_on > 0;
  const PortStatus status = port->status();
  return status == PortStatus::disconnected || (!wrong.disconnected_alone && status == PortStatus::overdue);
}

bool Expectations::need_faults() const noexcept {
  return std::ranges::any_of(checks_, [](const auto& c) { return c->wrong.fault && !c->wrong.name.empty(); });
}

void Expectations::fault(std::string_view of, FaultKind kind, bool begins) noexcept {
  for (const auto& check : checks_) {
    if (!check->safe_state || !check->wrong.is_of(of, kind)) continue;
    if (begins)
      ++check->faults_on;
    else if (check->faults_on > 0)
      --check->faults_on;
  }
}

void Expectations::made_safe(const CommandPort& port, BenchTime t) noexcept {
  for (const auto& check : checks_)
    if (check->safe_state && check->commands == &port) check->safe_state->made_safe(t);
}

void Expectations::command(const CommandPort& port, const Command& command) noexcept {
  const Duration since_start = command.t_issue - t0_;
  for (const auto& check : checks_) {
    if (check->commands != &port) continue;
    if (check->safe_state)
      check->safe_state->command(command);
    else if (check->subject == Subject::estimate)
      check->add_estimate(command);
    else if (check->in_window(since_start) && check->index < command.count)
      check->take(command.value[check->index], command.t_issue, since_start);
  }
}

void Expectations::cycle(BenchTime t) noexcept {
  const Duration since_start = t - t0_;
  for (const auto& check : checks_) {
    Check& c = *check;
    if (c.safe_state) {
      c.seen.t_last = t;
      c.safe_state->cycle(t, c.is_wrong(), c.in_window(since_start));
      continue;
    }
    if (!c.port) continue;
    if (c.subject == Subject::estimate) {
      c.take_truth(t0_);
      continue;
    }
    if (!c.in_window(since_start)) continue;
    expect::Seen& seen = c.seen;
    if (!seen.begun && c.from.ns() > 0) seen.first = c.port->counters(), seen.t_first = t;
    if (!seen.begun && c.from.ns() == 0) seen.t_first = t0_;
    seen.begun = true;
    seen.last = c.port->counters();
    seen.t_last = t;
    c.take_sample(since_start);
    if (c.quantity != Quantity::age_ms && c.quantity != Quantity::age_p99_ms) continue;
    if (c.port->status() != PortStatus::fresh || !c.port->sample()) continue;
    const Duration age = t - c.port->sample()->stamp.t_capture;
    if (c.quantity == Quantity::age_ms)
      c.look(age.seconds() * 1e3, since_start);
    else
      c.ages.record(age);
  }
  if (board_->asked.load(std::memory_order_acquire)) {
    board_->asked.store(false, std::memory_order_relaxed);
    show();
  }
}

void Expectations::ask() noexcept { board_->asked.store(true, std::memory_order_release); }

void Expectations::show() noexcept {
  for (std::size_t i = 0; i < checks_.size(); ++i) board_->seen[i]->store(checks_[i]->account());
}

std::vector<Expected> Expectations::so_far(const RunEnd& known) const {
  std::vector<Expected> out;
  for (std::size_t i = 0; i < checks_.size(); ++i)
    out.push_back(checks_[i]->outcome(board_->seen[i]->load(), known));
  return out;
}

std::vector<Expected> Expectations::finish(const RunEnd& end) {
  std::vector<Expected> out;
  for (const auto& check : checks_) out.push_back(check->outcome(check->account(), end));
  return out;
}

}  // namespace rigor
