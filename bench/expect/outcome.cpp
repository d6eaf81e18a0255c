// What comes of what a check has seen.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "bench/expect/check.h"
#include "bench/expect/samples_due.h"

namespace rigor {

using expect::Quantity;
using expect::Reactions;
using expect::Seen;

namespace {

/// Whether a recording says how it was: samples, statuses, commands, faults, alarms and skipped cycles are in
/// it.
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

/// Known when the run has ended, not before.
bool at_the_end(Quantity q) {
  switch (q) {
    case Quantity::wake_p50_us:
    case Quantity::wake_p99_us:
    case Quantity::wake_max_us:
    case Quantity::cycle_p99_us:
    case Quantity::late_answers:
    case Quantity::skipped_turns:
    case Quantity::restarts:
    case Quantity::answer_p99_ms:
      return true;
    default:
      return false;
  }
}

/// What only grows while the run goes on.
bool is_count(Quantity q) {
  switch (q) {
    case Quantity::missing:
    case Quantity::late:
    case Quantity::failed:
    case Quantity::late_commands:
    case Quantity::dropped:
    case Quantity::skipped:
    case Quantity::misses:
      return true;
    default:
      return false;
  }
}

double count(std::uint64_t n) { return static_cast<double>(n); }
double ms(Duration d) { return d.seconds() * 1e3; }
double us(Duration d) { return d.seconds() * 1e6; }

}  // namespace

std::string expect::Wrong::text() const {
  if (fault) return fmt::format("after {} of {}", kind ? fault_kind_name(*kind) : "a fault", name);
  return fmt::format("when {} is {}", name, disconnected_alone ? "disconnected" : "overdue");
}

Seen Expectations::Check::account() const noexcept {
  Seen s = seen;
  if (ages.count() > 0) s.age_p99_ms = ms(ages.percentile(0.99));
  if (safe_state) s.safe_state = safe_state->seen();
  return s;
}

Expected Expectations::Check::outcome(const Seen& s, const RunEnd& run) const {
  Expected e = expected;
  e.known = run.extent != RunEnd::Extent::recording || in_recordings(quantity);
  if (!e.known) return e;
  e.looked_at = s.looked_at;
  e.outside = s.outside;
  e.minimum = s.minimum;
  e.maximum = s.maximum;
  if (std::isfinite(s.first_s)) e.first_s = s.first_s;
  judge(e, s, run);
  if (run.extent == RunEnd::Extent::so_far) {
    e.decided = decided_so_far(e, s);
    if (e.nothing.empty())
      e.nothing = at_the_end(quantity) ? "known when the run has ended" : "nothing so far";
  }
  e.holds = e.decided && e.looked_at > 0 && e.outside == 0;
  return e;
}

bool Expectations::Check::decided_so_far(const Expected& e, const Seen& s) const {
  if (e.looked_at == 0) return false;
  if (quantity == Quantity::alarm) return e.minimum > 0 || !wanted_alarm;
  if (is_count(quantity)) return !(bounds.min && e.maximum < *bounds.min);
  // A sample more or less at the edges of the little that is there says nothing yet.
  if (quantity == Quantity::rate_hz && e.outside > 0) return due(s) > 10;
  return true;
}

/// Samples in what it has seen of the run.
std::uint64_t Expectations::Check::due(const Seen& s) const {
  const auto by = [&](BenchTime t) { return samples_due(t - s.t0, period, latency).value_or(0); };
  return by(s.t_last) - (from.ns() > 0 ? by(s.t_first) : 0);
}

void Expectations::Check::judge(Expected& e, const Seen& s, const RunEnd& run) const {
  /// Of a whole run or window: no instant.
  const auto is = [&](double v) {
    e.looked_at = 1;
    e.minimum = e.maximum = v;
    e.outside = !bounds.hold(v);
  };
  const std::uint64_t delivered = s.last.fresh + s.last.superseded - s.first.fresh - s.first.superseded;
  const auto sink = std::ranges::find(run.sinks, name, &RunEnd::Sink::name);
  const bool has_sink = sink != run.sinks.end();
  switch (quantity) {
    case Quantity::rate_hz: {
      if (!s.begun) break;
      const double span_s =
          period.ns() > 0 ? count(due(s)) * period.seconds() : (s.t_last - s.t_first).seconds();
      if (span_s > 0) is(count(delivered) / span_s);
      break;
    }
    case Quantity::missing: {
      if (!s.begun) break;
      const std::uint64_t n = due(s), behind = n > delivered ? n - delivered : 0;
      const std::uint64_t gaps = s.last.lost_samples - s.first.lost_samples;
      is(count(std::max(gaps, behind > samples_at_edges(n) ? behind : 0)));
      break;
    }
    case Quantity::late:
      if (s.begun) is(count(s.last.late_samples - s.first.late_samples));
      break;
    case Quantity::age_p99_ms:
      if (std::isfinite(s.age_p99_ms)) is(s.age_p99_ms);
      break;
    case Quantity::failed:
      if (has_sink) is(count(sink->failed));
      break;
    case Quantity::late_commands:
      if (has_sink) is(count(sink->late));
      break;
    case Quantity::dropped:
      if (has_sink) is(count(sink->dropped));
      break;
    case Quantity::wake_p50_us:
      if (run.loop) is(us(run.loop->wake_error.percentile(0.5)));
      break;
    case Quantity::wake_p99_us:
      if (run.loop) is(us(run.loop->wake_error.percentile(0.99)));
      break;
    case Quantity::wake_max_us:
      if (run.loop) is(us(run.loop->wake_error.max()));
      break;
    case Quantity::cycle_p99_us:
      if (run.loop) is(us(run.loop->cycle_time.percentile(0.99)));
      break;
    case Quantity::skipped:
      if (run.loop || run.skipped) is(count(run.loop ? run.loop->cycles_skipped : *run.skipped));
      break;
    case Quantity::misses:
      if (run.loop || run.misses) is(count(run.loop ? run.loop->misses.total : *run.misses));
      break;
    case Quantity::late_answers:
      if (run.application) is(count(run.application->late));
      break;
    case Quantity::skipped_turns:
      if (run.application) is(count(run.application->skipped));
      break;
    case Quantity::restarts:
      if (run.application) is(count(run.application->restarts));
      break;
    case Quantity::answer_p99_ms:
      if (run.application && run.application->answer.count() > 0)
        is(ms(run.application->answer.percentile(0.99)));
      break;
    case Quantity::alarm: {
      const auto came = std::ranges::find_if(run.alarms, [&](const RunEnd::Alarm& a) {
        return a.pair == name && in_window(seconds_from(a.t_s));
      });
      const bool there = came != run.alarms.end();
      e.looked_at = 1;
      e.minimum = e.maximum = there;
      e.outside = there != wanted_alarm;
      if (there && !wanted_alarm) e.first_s = came->t_s;
      break;
    }
    case Quantity::safe_after_ms:
      judge_reaction(e, s, run);
      break;
    case Quantity::age_ms:
    case Quantity::value:
    case Quantity::per_s:
    case Quantity::position_m:
    case Quantity::yaw_deg:
      break;
  }
}

void Expectations::Check::judge_reaction(Expected& e, const Seen& s, const RunEnd& run) const {
  const bool so_far = run.extent == RunEnd::Extent::so_far;
  const Reactions r = safe_state->reactions(s.safe_state, s.t_last, !so_far);
  e.looked_at = r.judged;
  e.outside = r.failed;
  e.minimum = ms(r.minimum);
  e.maximum = ms(r.maximum);
  if (so_far)
    e.nothing = r.begun > 0 ? "" : wrong.fault ? "no such fault so far" : "not so far";
  else if (r.begun == 0)
    e.nothing = wrong.fault ? "no such fault came: nothing was tested"
                            : fmt::format("it never was {}: nothing was tested",
                                          wrong.disconnected_alone ? "disconnected" : "overdue");
  else if (r.judged == 0)
    e.nothing = fmt::format("what came ({} times) was over before that: nothing was tested", r.begun);
  if (r.how == Reactions::How::none) return;
  e.first_s = (r.t_failed - s.t0).seconds();
  e.detail = fmt::format("it began at {:.3f} s; ", (r.t_began - s.t0).seconds());
  if (r.how == Reactions::How::never)
    e.detail += s.safe_state.waiting && so_far ? "not safe yet" : "not safe before it ended";
  else
    e.detail += fmt::format("safe after {:.6g} ms", ms(r.took));
  if (r.how == Reactions::How::left) e.detail += fmt::format(", but not from {:.3f} s on", *e.first_s);
}

}  // namespace rigor
