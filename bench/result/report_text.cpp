// The summary of a run for people.
#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/control/pair_snapshot.h"
#include "bench/result/run_report.h"
#include "bench/result/verdict_forms.h"

namespace rigor {
namespace {

std::string watch_lines(const PairWatchReport& w) {
  const pair_watch::PairWatchSnapshot& s = w.status.watch;
  std::string out = fmt::format("          watch: {}, {} windows", name_of(s.state), s.windows);
  if (s.state == pair_watch::WatchState::learning)
    out += fmt::format(" ({} of {} of the baseline)", s.learned, s.baseline_windows);
  double highest = -1;
  std::string of;
  for (std::size_t i = 0; i < w.parameters.size(); ++i)
    if (w.baseline[i].watched && w.baseline[i].highest > highest)
      highest = w.baseline[i].highest, of = w.parameters[i].name;
  if (!of.empty()) out += fmt::format(", highest sum {:.2f} of its threshold ({})", highest, of);
  out += '\n';
  if (s.alarms > 0)
    out +=
        fmt::format("          ALARM at {:.1f} s: {}\n", (s.t_alarm - w.status.t0).seconds(), w.status.text);
  return out;
}

std::string channel_lines(const ChannelReport& c, const ChannelFacts& f) {
  std::string out = fmt::format("{:<9} {} ", c.name, c.backend);
  if (f.due)
    out += fmt::format("{:.2f} of {:.2f} Hz, {} of {} samples, {} missing, {} late", f.rate_hz(),
                       c.period.hz(), f.delivered, *f.due, f.missing(), c.port.late_samples);
  else
    out += fmt::format("{} samples, {} lost, {} late", f.delivered, f.missing(), c.port.late_samples);
  if (f.silent)
    out += f.delivered > 0 ? fmt::format(", silent since {:.1f} s", f.last_s.value_or(0)) : ", silent";
  out +=
      fmt::format("; age p50 {} p99 {}\n", text_of(c.age.percentile(0.5)), text_of(c.age.percentile(0.99)));
  if (!c.replaced_by.empty()) out += fmt::format("          replaced by {}\n", c.replaced_by);
  if (c.pair) out += fmt::format("          pair: {}\n", pair_line(pair_json(*c.pair)));
  if (c.pair && c.pair->watch) out += watch_lines(*c.pair->watch);
  return out;
}

std::string loop_lines(const RunReport& r) {
  const RunSummary& s = r.outcome.loop;
  std::string out = fmt::format(
      "loop      {:g} Hz, {} cycles, {} skipped, {} overruns; wake-up p50 {} p99 {}; cycle p50 {} p99 {}\n",
      s.period.hz(), s.cycles_run, s.cycles_skipped, s.overruns, text_of(s.wake_error.percentile(0.5)),
      text_of(s.wake_error.percentile(0.99)), text_of(s.cycle_time.percentile(0.5)),
      text_of(s.cycle_time.percentile(0.99)));
  if (s.misses.total > 0) {
    out += fmt::format("misses    {}:", s.misses.total);
    for (std::size_t i = 0; i < kMissCauses; ++i)
      if (s.misses.by_cause[i] > 0)
        out += fmt::format(" {} {}", s.misses.by_cause[i], to_string(static_cast<MissCause>(i)));
    out += '\n';
  }
  for (const RealtimeSetting& g : s.settings)
    if (g.wanted && !g.granted) out += fmt::format("not granted: {}: {}\n", g.name, g.text);
  return out;
}

std::string application_line(const std::string& name, const ApplicationFacts& a) {
  std::string out = fmt::format("app       {}: {} turns, {} late, {} skipped, {} restarts", name, a.turns,
                                a.late, a.skipped, a.restarts);
  if (a.answer.count() > 0)
    out += fmt::format("; answers p50 {} p99 {}", text_of(a.answer.percentile(0.5)),
                       text_of(a.answer.percentile(0.99)));
  return out + '\n';
}

std::string bridge_line(const RunBridgeReport& b) {
  std::uint64_t received = 0, accepted = 0, rejected = 0;
  for (const auto& c : b.traffic.commands)
    received += c.received, accepted += c.accepted, rejected += c.rejected;
  std::string out = fmt::format("bridge    {}: {} topics, {} messages, {} dropped", b.name,
                                b.traffic.topics.size(), b.messages(), b.messages_dropped() + b.dropped);
  if (!b.traffic.commands.empty())
    out += fmt::format("; {} commands, {} given, {} rejected", received, accepted, rejected);
  return out + '\n';
}

std::string fault_lines(const ChannelFaultReport& report) {
  std::string out;
  const auto line = [&](const std::string& what, const auto& f) {
    out += fmt::format("fault     {}: {}: {} times on, {} seen, {} dropped, {} changed, {} delayed\n",
                       report.channel, what, f.times, f.seen, f.dropped, f.changed, f.delayed);
  };
  if (report.earlier) line(fmt::format("{} earlier live ones", report.earlier->faults), *report.earlier);
  for (const FaultReport& f : report.faults) line(f.text, f);
  return out;
}

}  // namespace

std::string RunReport::text() const {
  std::string out = verdict_text(verdict_json(verdict));
  out += fmt::format("{}: {:.1f} s on the {} clock, {}\n", identity.rig, duration_s(),
                     identity.wall_clock ? "wall" : "virtual", to_string(outcome.loop.reason));
  if (identity.virtual_epoch)
    out += fmt::format("time      virtual: every virtual run begins at {}\n", identity.utc);
  out += loop_lines(*this);
  for (std::size_t i = 0; i < channels.size(); ++i) out += channel_lines(channels[i], facts.channels[i]);
  for (const SinkReport& s : sinks)
    out += fmt::format("{:<9} {} {} commands, {} applied, {} late, {} failed\n", s.name, s.backend,
                       s.commands.accepted, s.commands.applied, s.commands.late, s.commands.failed);
  for (const RunBridgeReport& b : bridges) out += bridge_line(b);
  if (!expected.empty())
    out += fmt::format("expect    {} of {} hold\n",
                       std::ranges::count_if(expected, [](const Expected& e) { return e.known && e.holds; }),
                       expected.size());
  if (facts.application) out += application_line(identity.application, *facts.application);
  for (const ChannelFaultReport& f : faults) out += fault_lines(f);
  for (const AnalysisReport& a : analyses) out += fmt::format("{:<9} {}\n", a.name, a.line);
  if (recorded)
    out += fmt::format("recording {} ({} messages, {:.1f} MB, {} dropped)\n", recorded->file,
                       recorded->messages, static_cast<double>(recorded->bytes) * 1e-6, recorded->dropped);
  if (outcome.digest_wanted)
    out += fmt::format(
        "digest    of all that the application saw (a replay gives the same): {}\n",
        outcome.input_sha256.empty() ? "not known, its computation could not keep up" : outcome.input_sha256);
  return out;
}

}  // namespace rigor
