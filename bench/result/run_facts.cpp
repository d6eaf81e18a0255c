#include "bench/result/run_facts.h"

#include <fmt/format.h>

#include <algorithm>

#include "bench/devices/emulator_process.h"
#include "bench/sensing/sensors.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/fault_source.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_source.h"

namespace rigor {
namespace {

const char* noun_of(SampleKind kind) {
  switch (kind) {
    case SampleKind::image:
    case SampleKind::range_image:
      return "pictures";
    case SampleKind::point_cloud:
      return "scans";
    case SampleKind::can_frame:
      return "frames";
    default:
      return "samples";
  }
}

/// Mean time of a capture; 0: nothing computes one, or none was computed.
Duration capture_of(const RunParts& parts, const std::string& name) {
  for (const auto& [sensor, times] : parts.sensor_times)
    if (sensor == name)
      if (const std::uint64_t n = times->whole.count.load(); n > 0)
        return Duration(times->whole.wall_ns.load() / static_cast<std::int64_t>(n));
  return Duration(0);
}

std::uint64_t taken_by_faults(const RunParts& parts, const std::string& name) {
  if (!parts.faults) return 0;
  for (const FaultBench::Entry& e : parts.faults->entries())
    if (e.source && (e.name == name || e.name == name + ".real")) {
      const FaultySource::Accounts& a = e.source->accounts();
      return a.dropped.load() + a.disconnected.load();
    }
  return 0;
}

PairFacts pair_facts(const RunParts& parts, const RunChannel& c) {
  const PairSnapshot s = c.pair->statistics();
  PairFacts p;
  p.compared = s.compared;
  p.real_missing = s.missing_of(PairSide::real);
  p.simulated_missing = s.missing_of(PairSide::simulated);
  p.capture = capture_of(parts, c.entry->name + ".simulated");
  if (const PairMonitor* monitor = c.pair->monitor())
    if (const PairMonitor::Status status = monitor->status(); status.watch.alarms > 0) {
      p.alarm_s = (status.watch.t_alarm - status.t0).seconds();
      p.alarm_text = status.text;
    }
  return p;
}

/// Whether the device of a channel is an emulator that this run brought up.
bool emulated(const RunParts& parts, const RunChannel& c) {
  return parts.emulators != nullptr && parts.rig.emulator(c.entry->source.emulated_by) != nullptr;
}

}  // namespace

ChannelCounts counts_of(const RunChannel& c) {
  const PortCounters& n = c.port.counters();
  ChannelCounts out;
  out.delivered = n.fresh + n.superseded;
  out.late = n.late_samples;
  out.lost = n.lost_samples;
  out.disconnected_cycles = n.disconnected_cycles;
  out.lost_now = c.port.status() == PortStatus::disconnected;
  if (c.seen) out.t_last = c.t_last;
  if (c.arrival.count() > 0) out.arrival = c.arrival.percentile(0.99);
  return out;
}

RunFacts run_facts(const RunParts& parts, const LoopCounts& loop, const std::vector<ChannelCounts>& counts) {
  const RigConfig& rig = parts.rig;
  RunFacts run;
  run.wall_clock = rig.clock == ClockKind::wall;
  run.workers = rig.simulation.workers;
  run.cycles = loop.cycles;
  run.skipped = loop.skipped;
  run.misses = loop.misses;
  const Duration elapsed = loop.now - loop.t0;
  for (std::size_t i = 0; i < parts.channels.size(); ++i) {
    const RunChannel& c = *parts.channels[i];
    const ChannelCounts& n = counts[i];
    ChannelFacts f;
    f.name = c.entry->name;
    f.noun = noun_of(c.entry->kind);
    f.period = c.entry->period;
    f.latency = c.entry->latency;
    f.due = samples_due(elapsed, f.period, f.latency);
    f.delivered = n.delivered;
    f.late = n.late;
    f.lost = n.lost;
    if (n.t_last) f.last_s = std::max(0.0, (*n.t_last - loop.t0).seconds());
    f.silent = n.lost_now || (f.due.value_or(0) > 2 && n.delivered == 0);
    f.gone_s = static_cast<double>(n.disconnected_cycles) * rig.loop.period.seconds();
    f.arrival = n.arrival;
    f.by_faults = taken_by_faults(parts, f.name);
    f.emulated = emulated(parts, c);
    if (c.pair)
      f.pair = pair_facts(parts, c);
    else
      f.capture = capture_of(parts, f.name);
    run.channels.push_back(std::move(f));
  }
  for (const auto& s : parts.sinks) {
    const SinkSnapshot n = s->sink->counters();
    run.sinks.push_back({s->entry->name, n.accepted, n.late, n.failed, n.dropped});
  }
  if (parts.emulators)
    if (const auto death = parts.emulators->death())
      run.emulators =
          fmt::format("emulators: their process {} died {:.1f} s into the run ({})", parts.emulators->pid(),
                      std::max(0.0, (death->t - loop.t0).seconds()), death->how);
  return run;
}

RunEnd run_end(const RunFacts& facts) {
  RunEnd end;
  for (const SinkFacts& s : facts.sinks) end.sinks.push_back({s.name, s.failed, s.late, s.dropped});
  for (const ChannelFacts& c : facts.channels)
    if (c.pair && !c.pair->alarm_text.empty()) end.alarms.push_back({c.name, c.pair->alarm_s});
  end.application = facts.application;
  return end;
}

}  // namespace rigor
