#include "bench/result/collect_report.h"

#include <algorithm>

#include "bench/control/fault_control.h"
#include "bench/control/pair_snapshot.h"
#include "bench/result/run_facts.h"
#include "bench/run/bridges.h"
#include "bench/run/run_json.h"
#include "bench/sensing/sensors.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {

namespace {

ChannelReport channel_report(const RunChannel& c, const FaultBench* faults) {
  ChannelReport r;
  r.name = c.entry->name;
  r.kind = c.entry->kind;
  r.backend = c.entry->is_pair ? c.entry->source.backend + " | " + c.entry->simulated.backend
                               : c.entry->source.backend;
  r.replaced_by = c.replaced_by;
  r.period = c.entry->period;
  r.latency = c.entry->latency;
  r.port = c.port.counters();
  r.health = c.source->health();
  r.taken = c.taken;
  r.before_start = c.before_start;
  r.age = c.age;
  r.arrival = c.arrival;
  r.gap_count = c.gap_count;
  r.gaps.assign(c.gaps.begin(), c.gaps.begin() + std::min(c.gap_count, RunChannel::kKept));
  r.status.assign(c.spans.begin(), c.spans.begin() + std::min(c.span_count, RunChannel::kKept));
  if (faults)
    for (const FaultBench::Entry& e : faults->entries())
      if (e.source && (e.name == r.name || (c.pair && e.name.rfind(r.name + ".", 0) == 0)))
        r.faulty.push_back(faulty_report(*e.source, e.name));
  if (c.pair) {
    r.pair = pair_report(c, true);
    r.pair->series.assign(c.differences.begin(),
                          c.differences.begin() + std::min(c.difference_count, RunChannel::kKept));
  }
  return r;
}

std::vector<SensorTimeReport> sensor_times(const RunParts& parts) {
  std::vector<SensorTimeReport> all;
  const auto seconds_of = [](const std::atomic<std::int64_t>& ns) {
    return static_cast<double>(ns.load()) * 1e-9;
  };
  for (const auto& [name, times] : parts.sensor_times)
    if (const StageTime& whole = times->whole; whole.count.load() > 0)
      all.push_back({name, whole.count.load(), seconds_of(whole.wall_ns), seconds_of(times->world.wall_ns),
                     seconds_of(times->collect.wall_ns), seconds_of(times->prepare.wall_ns),
                     seconds_of(times->light.wall_ns), seconds_of(whole.cpu_ns),
                     static_cast<double>(whole.longest_ns.load()) * 1e-6});
  return all;
}

}  // namespace

RunFacts ended_run_facts(const RunParts& parts, const RunOutcome& outcome, const Recorder* recorder,
                         const std::vector<std::string>& warnings) {
  const RunSummary& s = outcome.loop;
  LoopCounts loop{outcome.t0, outcome.t0, s.cycles_run, s.cycles_skipped, s.misses.total};
  if (const std::uint64_t cycles = s.cycles_run + s.cycles_skipped; cycles > 0)
    loop.now = outcome.t0 + s.period * static_cast<std::int64_t>(cycles - 1);
  std::vector<ChannelCounts> counts;
  for (const auto& c : parts.channels) counts.push_back(counts_of(*c));
  RunFacts facts = run_facts(parts, loop, counts);
  if (recorder) facts.recording_dropped = recorder->statistics().dropped;
  facts.digest_known = !outcome.digest_wanted || !outcome.input_sha256.empty();
  facts.warnings = warnings;
  if (parts.application) facts.application = parts.application->facts();
  for (const RunBridgeReport& b : bridge_reports(parts)) {
    BridgeFacts f;
    f.name = b.name;
    f.messages = b.messages() + b.dropped;
    f.dropped = b.messages_dropped() + b.dropped;
    for (const auto& c : b.traffic.commands) {
      f.commands += c.received;
      f.rejected += c.rejected;
      if (!c.last_rejection.empty()) f.last_rejection = c.topic + ": " + c.last_rejection;
    }
    f.problems = b.traffic.problems;
    facts.bridges.push_back(std::move(f));
  }
  return facts;
}

void collect_parts(const RunParts& parts, const Recorder* recorder, RunReport& report) {
  for (const auto& c : parts.channels) report.channels.push_back(channel_report(*c, parts.faults.get()));
  for (const auto& s : parts.sinks) report.sinks.push_back(sink_report(*s));
  report.bridges = bridge_reports(parts);
  if (parts.faults)
    for (const FaultBench::Entry& e : parts.faults->entries())
      if (!e.injector->scheduled().empty() || !e.injector->live().empty())
        report.faults.push_back(fault_report(e, &report.outcome.t0));
  report.sensor_times = sensor_times(parts);
  if (recorder) {
    const Recorder::Statistics s = recorder->statistics();
    report.recorded = {parts.rig.record.file.string(),
                       s.messages,
                       s.bytes,
                       s.chunks,
                       s.samples,
                       s.dropped,
                       s.after_end,
                       s.cpu_s};
  }
}

}  // namespace rigor
