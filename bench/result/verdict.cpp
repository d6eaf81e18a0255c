#include "bench/result/verdict.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "bench/console/terminal.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {
namespace {

constexpr std::array<const char*, kFindingKinds> kNames{
    "expect", "lost",    "late",        "silent",    "emulator", "alarm",   "uncompared", "skipped",
    "missed", "command", "application", "recording", "digest",   "warning", "bridge"};

// Where a note becomes a warning, and a warning bad; shares of what was due.
constexpr double kLostBad = 0.05, kLateWarning = 0.01, kLateBad = 0.2, kMissedWarning = 0.01,
                 kSkippedWarning = 0.001, kSkippedBad = 0.05, kComparedWarning = 0.9, kBridgeWarning = 0.01;
// A simulated channel is computed in time where it takes this share of its period.
constexpr double kLoad = 0.8;

double share(std::uint64_t n, std::uint64_t of) {
  return of > 0 ? static_cast<double>(n) / static_cast<double>(of) : 0.0;
}
std::string singular(const std::string& noun) {
  return noun.ends_with('s') ? noun.substr(0, noun.size() - 1) : noun;
}

/// The highest round rate up to `wanted_hz`; 0: none.
double round_rate(double wanted_hz) {
  for (double power = 1000; power >= 0.01; power /= 10)
    for (const double step : {5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0})
      if (step * power <= wanted_hz) return step * power;
  return 0;
}

/// Threads that the simulated channels of a run keep busy.
double load(const RunFacts& run) {
  double sum = 0;
  for (const ChannelFacts& c : run.channels)
    if (c.period.ns() > 0)
      sum += (c.capture.seconds() + (c.pair ? c.pair->capture.seconds() : 0)) / c.period.seconds();
  return sum;
}

std::string slower(const ChannelFacts& c, double rate_hz) {
  const double rate = round_rate(rate_hz);
  return rate > 0 && rate * c.period.seconds() < 1
             ? fmt::format("use `--clock virtual` or `--set channels.{}.rate_hz={:g}`", c.name, rate)
             : "use `--clock virtual`";
}

/// Adds why the samples of a simulated channel on the wall clock are missing or late, and what helps.
/// `capture`: the time to compute one.
void explain_simulated(const RunFacts& run, const ChannelFacts& c, Duration capture, Finding& f) {
  const double capture_s = capture.seconds(), period_s = c.period.seconds(), busy = load(run),
               room = kLoad * run.workers;
  if (period_s <= 0) return;
  const std::string one = singular(c.noun);
  double rate_hz = kLoad / capture_s;
  if (busy > room) rate_hz = std::min(rate_hz, room / busy / period_s);
  if (capture_s > kLoad * period_s) {
    f.sentence += fmt::format("; a {} takes {} of its {} period", one, text_of(capture), text_of(c.period));
  } else if (busy > room) {
    f.sentence += fmt::format("; the simulated channels need {:.1f} threads and `simulation.workers` is {}",
                              busy, run.workers);
  } else if (capture > c.latency) {
    f.sentence +=
        fmt::format("; a {} takes {} and is due after {}", one, text_of(capture), text_of(c.latency));
    f.cure = fmt::format("use `--clock virtual` or `--set channels.{}.latency_ms={:.0f}`", c.name,
                         std::ceil(capture_s * 150) * 10);
    return;
  } else {
    f.cure = "use `--clock virtual`, or leave this machine less other work";
    return;
  }
  f.cure = slower(c, rate_hz);
}

std::optional<Finding> judge_samples(const RunFacts& run, const ChannelFacts& c) {
  const std::uint64_t due = c.due.value_or(c.delivered + c.lost);
  const std::uint64_t missing = c.missing();
  const bool lost = c.lost > 0 || missing > samples_at_edges(due);
  if (!lost && c.late == 0 && !c.silent) return std::nullopt;
  Finding f;
  f.channel = c.name;
  f.severity = Severity::note;
  const auto at_least = [&](Severity s) { f.severity = std::max(f.severity, s); };
  if (lost) f.kinds.add(FindingKind::lost), at_least(Severity::warning);
  if (lost && share(missing, due) >= kLostBad) at_least(Severity::bad);
  if (c.late > 0) {
    f.kinds.add(FindingKind::late);
    const double of = share(c.late, c.delivered);
    at_least(of >= kLateBad ? Severity::bad : of >= kLateWarning ? Severity::warning : Severity::note);
  }
  if (c.silent) f.kinds.add(FindingKind::silent), at_least(Severity::bad);

  if (c.delivered == 0 && c.due)
    f.sentence = fmt::format("{}: none of {} {} came", c.name, due, c.noun);
  else if (c.due)
    f.sentence = fmt::format("{}: {} of {} {}", c.name, c.delivered, due, c.noun);
  else
    f.sentence = fmt::format("{}: {} {}", c.name, c.delivered, c.noun);
  if (!c.due && c.lost > 0) f.sentence += fmt::format(", {} lost", c.lost);
  if (c.late > 0)
    f.sentence +=
        lost ? fmt::format(", {} of them late", c.late) : fmt::format(" came, {} of them late", c.late);
  else if (c.due && !lost)
    f.sentence += " came";
  if (c.silent && c.last_s)
    f.sentence += fmt::format("; silent since {:.1f} s", *c.last_s);
  else if (c.gone_s >= 0.1 && c.delivered > 0)
    f.sentence += fmt::format("; disconnected or silent for {:.1f} s", c.gone_s);
  if (c.by_faults > 0)
    f.sentence += fmt::format("; injected faults took {} of them", std::min(c.by_faults, missing));

  const bool simulated = c.capture.ns() > 0;
  if (run.wall_clock && simulated && !c.silent && (c.by_faults == 0 || c.by_faults < missing))
    explain_simulated(run, c, c.capture, f);
  else if (run.wall_clock && c.emulated && !c.silent && run.emulators.empty() && c.by_faults == 0 &&
           share(missing, due) >= kLostBad) {
    f.sentence += "; its emulator, on this machine, is too slow";
    f.cure = slower(c, kLoad * c.rate_hz());
  } else if (c.silent && run.wall_clock && run.emulators.empty() && c.by_faults == 0)
    f.cure = "look at the device and its connection (`rigor devices`)";
  else if (c.late > 0 && c.arrival > c.latency && c.by_faults == 0)
    f.cure = fmt::format("99 % of its {} are here after {}: `--set channels.{}.latency_ms={:.0f}`", c.noun,
                         text_of(c.arrival), c.name, std::ceil(c.arrival.seconds() * 1100 / 5) * 5);
  return f;
}

void judge_pair(const RunFacts& run, const ChannelFacts& c, std::vector<Finding>& out) {
  const PairFacts& p = *c.pair;
  if (!p.alarm_text.empty()) {
    Finding f;
    f.kinds.add(FindingKind::alarm);
    f.severity = Severity::bad;
    f.channel = c.name;
    f.sentence = fmt::format("{}: alarm at {:.1f} s: {}", c.name, p.alarm_s, p.alarm_text);
    f.cure = "see docs/pair-watch.md for what to do after an alarm";
    out.push_back(std::move(f));
  }
  const std::uint64_t due = c.due.value_or(0);
  if (due <= samples_at_edges(due) ||
      static_cast<double>(p.compared) >= kComparedWarning * static_cast<double>(due))
    return;
  Finding f;
  f.kinds.add(FindingKind::uncompared);
  f.severity = p.compared == 0 ? Severity::bad : Severity::warning;
  f.channel = c.name;
  f.sentence = p.compared == 0 ? fmt::format("{}: not one of {} pairs was compared", c.name, due)
                               : fmt::format("{}: {} of {} pairs compared", c.name, p.compared, due);
  f.sentence += fmt::format(" (missing: {} of the real side, {} of the simulated)", p.real_missing,
                            p.simulated_missing);
  if (run.wall_clock && p.capture.ns() > 0 && p.simulated_missing > p.real_missing)
    explain_simulated(run, c, p.capture, f);
  out.push_back(std::move(f));
}

void judge_loop(const RunFacts& run, std::vector<Finding>& out) {
  if (run.skipped == 0 && run.misses == 0) return;
  const std::uint64_t all = run.cycles + run.skipped;
  Finding f;
  f.severity = Severity::note;
  const auto at_least = [&](Severity s) { f.severity = std::max(f.severity, s); };
  f.sentence = "loop:";
  if (run.misses > 0) {
    f.kinds.add(FindingKind::missed);
    if (share(run.misses, all) >= kMissedWarning) at_least(Severity::warning);
    f.sentence += fmt::format(" {} of {} cycles missed their instant", run.misses, all);
  }
  if (run.skipped > 0) {
    f.kinds.add(FindingKind::skipped);
    const double of = share(run.skipped, all);
    if (of >= kSkippedWarning) at_least(of >= kSkippedBad ? Severity::bad : Severity::warning);
    f.sentence += run.misses > 0 ? fmt::format(", {} were skipped", run.skipped)
                                 : fmt::format(" {} of {} cycles were skipped", run.skipped, all);
  }
  if (f.severity > Severity::note) f.cure = "`rigor doctor` says what this machine lacks for real time";
  out.push_back(std::move(f));
}

void judge_sink(const SinkFacts& s, std::vector<Finding>& out) {
  const std::uint64_t gone = s.failed + s.dropped;
  if (gone == 0 && s.late == 0) return;
  Finding f;
  f.kinds.add(FindingKind::command);
  f.channel = s.name;
  const std::uint64_t all = s.accepted + s.dropped;
  f.severity = share(gone, all) >= kLostBad                     ? Severity::bad
               : gone > 0 || share(s.late, all) >= kLateWarning ? Severity::warning
                                                                : Severity::note;
  std::vector<std::string> parts;
  for (const auto& [n, what] :
       {std::pair{s.failed, "failed"}, {s.dropped, "found no place"}, {s.late, "late"}})
    if (n > 0) parts.push_back(fmt::format("{} {}", n, what));
  f.sentence = fmt::format("{}: of {} commands {}", s.name, all, fmt::join(parts, ", "));
  out.push_back(std::move(f));
}

void judge_application(const ApplicationFacts& a, std::vector<Finding>& out) {
  if (a.late == 0 && a.skipped == 0 && a.restarts == 0 && a.dropped == 0) return;
  Finding f;
  f.kinds.add(FindingKind::application);
  const std::uint64_t due = a.turns + a.skipped;
  f.severity = a.restarts > 0 || share(a.skipped, due) >= kLateBad               ? Severity::bad
               : a.dropped > 0 || share(a.late + a.skipped, due) >= kLateWarning ? Severity::warning
                                                                                 : Severity::note;
  std::vector<std::string> parts;
  if (a.restarts > 0) parts.push_back(fmt::format("it was started again {} times", a.restarts));
  if (a.skipped > 0) parts.push_back(fmt::format("{} of {} turns were skipped", a.skipped, due));
  if (a.late > 0) parts.push_back(fmt::format("{} of {} answers were late", a.late, a.turns));
  if (a.dropped > 0) parts.push_back(fmt::format("{} samples did not reach it", a.dropped));
  f.sentence = fmt::format("application: {}", fmt::join(parts, ", "));
  if (a.skipped > 0 && a.answer.count() > 0)
    f.cure = fmt::format("give it a `rate_hz` that it keeps (99 % of its answers take up to {:.3g} ms)",
                         a.answer.percentile(0.99).seconds() * 1e3);
  out.push_back(std::move(f));
}

Finding of_run(FindingKind kind, Severity severity, std::string sentence, std::string cure = {}) {
  Finding f;
  f.kinds.add(kind);
  f.severity = severity;
  f.sentence = std::move(sentence);
  f.cure = std::move(cure);
  return f;
}

}  // namespace

const char* name_of(FindingKind kind) noexcept { return kNames[static_cast<std::size_t>(kind)]; }
const char* name_of(Severity severity) noexcept {
  return severity == Severity::bad ? "bad" : severity == Severity::warning ? "warning" : "note";
}

std::vector<std::string> FindingSet::names() const {
  std::vector<std::string> out;
  for (std::size_t i = 0; i < kFindingKinds; ++i)
    if (has(static_cast<FindingKind>(i))) out.emplace_back(kNames[i]);
  return out;
}

Result<FindingSet> findings_named(const std::vector<std::string>& names) {
  FindingSet set;
  const std::vector<std::string> known(kNames.begin(), kNames.end());
  for (const std::string& name : names) {
    const auto it = std::ranges::find(known, name);
    if (it == known.end()) {
      const std::string near = nearest(name, known);
      return fail(
          ErrorCode::bad_input, "--fail-on",
          fmt::format("expected one or more of {}, separated by commas; got \"{}\"{}", fmt::join(known, ", "),
                      name, near.empty() ? "" : "; did you mean " + near + "?"));
    }
    set.add(static_cast<FindingKind>(it - known.begin()));
  }
  return set;
}

std::string Finding::text() const { return cure.empty() ? sentence : sentence + "; " + cure; }

std::uint64_t ChannelFacts::missing() const {
  const std::uint64_t behind = due && *due > delivered ? *due - delivered : 0;
  return std::max(behind, lost);
}
double ChannelFacts::rate_hz() const {
  if (!due || *due == 0) return 0;
  return static_cast<double>(delivered) / (static_cast<double>(*due) * period.seconds());
}

Severity Verdict::worst() const {
  Severity s = Severity::note;
  for (const Finding& f : findings) s = std::max(s, f.severity);
  return s;
}
FindingSet Verdict::found(FindingSet wanted) const {
  FindingSet out;
  for (const Finding& f : findings)
    for (std::size_t i = 0; i < kFindingKinds; ++i)
      if (const auto k = static_cast<FindingKind>(i); f.kinds.has(k) && wanted.has(k)) out.add(k);
  return out;
}

namespace {

void judge_bridge(const BridgeFacts& b, std::vector<Finding>& findings) {
  if (b.dropped > 0)
    findings.push_back(
        of_run(FindingKind::bridge,
               share(b.dropped, b.messages) >= kBridgeWarning ? Severity::warning : Severity::note,
               fmt::format(
                   "bridge {}: of {} messages {} were dropped, because a peer or the network did not keep up",
                   b.name, b.messages, b.dropped),
               "send fewer channels (`channels`, `topics`), or at best effort (`qos: sensor_data`), which "
               "loses them uncounted"));
  if (b.rejected > 0)
    findings.push_back(of_run(FindingKind::bridge, Severity::warning,
                              fmt::format("bridge {}: {} of {} commands were rejected, the last: {}", b.name,
                                          b.rejected, b.commands, b.last_rejection)));
  for (const std::string& problem : b.problems)
    findings.push_back(
        of_run(FindingKind::bridge, Severity::warning, fmt::format("bridge {}: {}", b.name, problem)));
}

}  // namespace

Verdict judge(const RunFacts& run) {
  Verdict v;
  if (!run.emulators.empty())
    v.findings.push_back(of_run(FindingKind::emulator, Severity::bad, run.emulators));
  for (const std::string& sentence : run.unmet)
    v.findings.push_back(of_run(FindingKind::expect, Severity::bad, sentence));
  for (const ChannelFacts& c : run.channels) {
    if (auto f = judge_samples(run, c)) v.findings.push_back(std::move(*f));
    if (c.pair) judge_pair(run, c, v.findings);
  }
  for (const SinkFacts& s : run.sinks) judge_sink(s, v.findings);
  if (run.application) judge_application(*run.application, v.findings);
  judge_loop(run, v.findings);
  for (const BridgeFacts& b : run.bridges) judge_bridge(b, v.findings);
  if (run.recording_dropped > 0)
    v.findings.push_back(
        of_run(FindingKind::recording, Severity::warning,
               fmt::format("recording: {} samples found no place and are not in it", run.recording_dropped),
               "record fewer channels (`record: false`) or onto a faster disk"));
  if (!run.digest_known)
    v.findings.push_back(of_run(FindingKind::digest, Severity::note,
                                "input digest: not known, its computation could not keep up; a replay of "
                                "this run cannot be compared with it"));
  for (const std::string& w : run.warnings)
    v.findings.push_back(of_run(FindingKind::warning, Severity::warning, w));
  std::ranges::stable_sort(v.findings,
                           [](const Finding& a, const Finding& b) { return a.severity > b.severity; });
  return v;
}

}  // namespace rigor
