#include "bench/run/bench_run.h"

#include <time.h>

#include <algorithm>
#include <thread>

#include "bench/plant/plant.h"
#include "bench/run/bridges.h"
#include "bench/run/tap.h"
#include "rt-core/affinity.h"
#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/replay_source.h"
#include "sim/platform/platform.h"

namespace rigor {
namespace {

ExecutiveConfig executive_config(const RigConfig& rig, Heartbeat& heartbeat, Trace* trace,
                                 ExecutiveHooks& hooks) {
  ExecutiveConfig c;
  c.period = rig.loop.period;
  c.cycles = rig.duration.ns() > 0 ? cycles_in(rig.duration, rig.loop.period) : 0;
  c.heartbeat = &heartbeat;
  c.trace = trace;
  c.hooks = &hooks;
  switch (rig.loop.overrun) {
    case OverrunChoice::skip:
      c.on_overrun = OverrunPolicy::skip;
      break;
    case OverrunChoice::abort:
      c.on_overrun = OverrunPolicy::abort;
      break;
    case OverrunChoice::log:
      c.on_overrun = OverrunPolicy::log;
      break;
  }
  if (rig.clock == ClockKind::virtual_time) {
    c.clock = RunClock::virtual_time;
    return c;
  }
  c.spin = rig.loop.spin;
  c.realtime = RealtimeConfig{};
  c.realtime.fifo_priority = rig.loop.fifo_priority;
  c.realtime.cpu = rig.loop.cpu < 0 ? RealtimeConfig::kAutoCpu : rig.loop.cpu;
  c.realtime.lock_memory = rig.loop.lock_memory;
  c.realtime.hold_dma_latency = rig.loop.dma_latency;
  return c;
}

Duration process_cpu() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return Duration(std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec);
}

}  // namespace

BenchRun::BenchRun(RunParts& parts, Trace* trace)
    : parts_(parts), executive_(executive_config(parts.rig, heartbeat_, trace, *this)) {}

BenchRun::~BenchRun() { (void)stop(); }

void BenchRun::set_recorder(Recorder* recorder) {
  recorder_ = recorder;
  recorders_.clear();
  if (recorder) recorders_.push_back(recorder);
  for (const auto& bridge : parts_.bridges)
    if (bridge->recorder) recorders_.push_back(bridge->recorder.get());
}

Status BenchRun::arm(StopToken stop) {
  const bool virtual_time = parts_.rig.clock == ClockKind::virtual_time;
  heartbeat_.restart(virtual_time);
  for (auto& channel : parts_.channels)
    ports_.inputs[channel->entry->name] = {channel->entry->name, &channel->source->describe(),
                                           &channel->port};
  for (auto& sink : parts_.sinks) {
    sink->port = std::make_unique<CommandPort>(sink->entry->name, *sink->sink, sink->entry->latency);
    sink->sink->watch(&heartbeat_, parts_.rig.loop.heartbeat_deadline);
    ports_.outputs[sink->entry->name] = sink->port.get();
  }
  ports_.stop = stop;
  if (parts_.expectations)
    if (auto s = parts_.expectations->bind(ports_); !s) return s;
  if (parts_.application) {
    // What it starts leaves the loop's CPU alone.
    const AvoidCpu rest(virtual_time ? -1 : loop_cpu(executive_.config().realtime));
    if (auto s = parts_.application->configure(parts_.rig.application_params, ports_, parts_.rig.loop.period);
        !s)
      return s;
  }

  const auto step = [&](const char* name, std::vector<std::string> after,
                        void (BenchRun::*body)(const CycleContext&) noexcept) {
    return executive_.add_step({.name = name, .after = std::move(after)},
                               [this, body](const CycleContext& c) noexcept { (this->*body)(c); });
  };
  if (auto s = step("inputs", {}, &BenchRun::inputs); !s) return s;
  if (auto s = step("capture", {"inputs"}, &BenchRun::capture); !s) return s;
  if (auto s = step("application", {"inputs", "capture"}, &BenchRun::application); !s) return s;
  if (auto s = step("outputs", {"application"}, &BenchRun::outputs); !s) return s;

  if (auto s = arm_channels(stop); !s) return s;
  if (digest_wanted_) {
    std::vector<SampleKind> kinds;
    for (const auto& channel : parts_.channels) kinds.push_back(channel->source->describe().kind);
    digest_ = std::make_unique<InputDigest>(kinds, virtual_time);
  }
  event_pool_ = make_sample_pool(2 * parts_.sinks.size() + 16, 0);
  const auto cycles = static_cast<std::uint64_t>(parts_.rig.duration / parts_.rig.loop.period);
  note_every_ = std::max<std::uint64_t>(
      cycles / (RunChannel::kKept - 2),
      static_cast<std::uint64_t>(std::max<std::int64_t>(1, milliseconds(100) / parts_.rig.loop.period)));
  return executive_.arm();
}

Status BenchRun::arm_channels(StopToken stop) {
  const ArmContext context{.virtual_time = parts_.rig.clock == ClockKind::virtual_time,
                           .loop_period = parts_.rig.loop.period};
  const auto interrupted = [&] {
    return fail(ErrorCode::unavailable, parts_.rig.name,
                "interrupted while the channels were being armed; the devices are in their safe state");
  };
  for (auto& plant : parts_.plants) {
    if (stop.stop_requested()) return interrupted();
    if (auto s = plant->arm(context.virtual_time, stop); !s) return s;
  }
  for (auto& sink : parts_.sinks) {
    if (stop.stop_requested()) return interrupted();
    if (auto s = sink->sink->arm(context); !s) return s;
  }
  for (auto& channel : parts_.channels) {
    if (stop.stop_requested()) return interrupted();
    if (auto s = channel->source->arm(context); !s) return s;
  }
  return {};
}

std::vector<std::string> BenchRun::warnings() const {
  std::vector<std::string> all;
  for (const auto& channel : parts_.channels)
    for (std::string& w : channel->source->warnings()) all.push_back(std::move(w));
  for (const auto& plant : parts_.plants)
    for (std::string& w : plant->warnings()) all.push_back(std::move(w));
  return all;
}

std::vector<std::string> BenchRun::forecasts() const {
  std::vector<std::string> all;
  for (const auto& channel : parts_.channels)
    for (std::string& f : channel->source->forecasts()) all.push_back(std::move(f));
  return all;
}

Status BenchRun::start_channels(BenchTime t0) {
  t0_ = t0;
  origin_.publish(t0);
  if (parts_.expectations) parts_.expectations->begin(t0);
  for (Recorder* r : recorders_) r->begin(t0);
  if (live_) live_->begin(t0);
  next_recorded_fault_ = 0;
  // Platforms first: a sink tells its own the safe values of the start.
  for (auto& platform : parts_.platforms) platform->start(t0);
  for (auto& plant : parts_.plants) plant->start(t0);
  for (auto& sink : parts_.sinks) {
    if (auto s = sink->sink->start(t0); !s) return s;
    sink->made_safe = sink->sink->counters().made_safe;
  }
  for (auto& channel : parts_.channels) {
    if (auto s = channel->source->start(t0); !s) return s;
    channel->port.configure(channel->entry->timing, t0);
  }
  began_ = parts_.rig.clock == ClockKind::wall ? MonotonicTime(t0.ns()) : monotonic_now();
  cpu_at_begin_ = process_cpu();
  return {};
}

RunOutcome BenchRun::outcome_of(RunSummary summary) {
  RunOutcome outcome;
  outcome.cpu_s = (process_cpu() - cpu_at_begin_).seconds();
  outcome.wall_s = (monotonic_now() - began_).seconds();
  heartbeat_.declare_stopped(summary.reason);
  if (parts_.expectations) parts_.expectations->show();
  outcome.t0 = t0_;
  outcome.digest_wanted = digest_wanted_;
  if (digest_) outcome.input_sha256 = digest_->finish();
  outcome.loop = std::move(summary);
  return outcome;
}

Result<RunOutcome> BenchRun::run(StopToken stop_token, std::optional<BenchTime> t0) {
  const bool wall = parts_.rig.clock == ClockKind::wall;
  auto summary = executive_.run(stop_token, [&]() -> Result<BenchTime> {
    const BenchTime first = t0 ? *t0 : wall ? bench_now() + kLead : BenchTime(0);
    if (auto s = start_channels(first); !s) return tl::unexpected<Error>(s.error());
    return first;
  });
  if (!summary) return tl::unexpected<Error>(summary.error());
  return outcome_of(std::move(*summary));
}

Status BenchRun::begin(BenchTime t0) {
  return executive_.begin([&]() -> Result<BenchTime> {
    if (auto s = start_channels(t0); !s) return tl::unexpected<Error>(s.error());
    return t0;
  });
}

RunOutcome BenchRun::end() { return outcome_of(executive_.end()); }

Status BenchRun::stop() {
  Status first;
  const auto keep_first = [&](Status s) {
    if (!s && first) first = s;
  };
  heartbeat_.declare_stopped(StopReason::requested);
  for (auto& sink : parts_.sinks)
    if (sink->sink->state() == ChannelState::armed || sink->sink->state() == ChannelState::running)
      keep_first(sink->sink->stop());
  for (auto& channel : parts_.channels)
    if (channel->source->state() == ChannelState::armed || channel->source->state() == ChannelState::running)
      keep_first(channel->source->stop());
  for (auto& plant : parts_.plants) plant->stop();
  if (executive_.state() == Executive::State::armed) keep_first(executive_.disarm());
  return first;
}

void BenchRun::keep_pace(BenchTime t) {
  const Duration due(
      (t - t0_).ns() > 0 ? static_cast<std::int64_t>(static_cast<double>((t - t0_).ns()) / pace_) : 0);
  const Duration passed = monotonic_now() - began_;
  if (due > passed) std::this_thread::sleep_for(std::chrono::nanoseconds((due - passed).ns()));
}

void BenchRun::before_cycle(BenchTime t) {
  if (pace_ > 0) keep_pace(t);
  if (parts_.faults) parts_.faults->begin_cycle(t);
  for (auto& sink : parts_.sinks) sink->sink->complete_until(t);
  for (auto& channel : parts_.channels) channel->source->complete_until(t);
}

void BenchRun::cycle_begin(const CycleContext& cycle) noexcept {
  // A cycle that the recorded run skipped is skipped for whoever replays this run's recording, too.
  skip_this_cycle_ = ran_ && !ran_(cycle.index);
  if (!skip_this_cycle_) {
    if (cycle.index > next_cycle_)
      for (Recorder* r : recorders_) r->record_skipped(next_cycle_, cycle.index - next_cycle_, cycle.t);
    next_cycle_ = cycle.index + 1;
  }
  if (live_) {
    const LoopCounters& n = executive_.counters();
    live_->cycle(cycle.t, Duration(n.last_wake_error_ns.load(std::memory_order_relaxed)),
                 Duration(n.last_cycle_ns.load(std::memory_order_relaxed)));
  }
}

void BenchRun::take_up_faults(const CycleContext& cycle) noexcept {
  parts_.faults->begin_cycle(cycle.t);
  FaultChange change;
  while (const FaultBench::Entry* at = parts_.faults->poll_change(change)) {
    if (parts_.expectations) parts_.expectations->fault(at->name, change.fault->kind, change.begins);
    if (live_) live_->fault(change);
    for (Recorder* r : recorders_) r->record_fault(change);
    if (!change.event) continue;
    if (live_) live_->event(at->channel, change.event);
    for (Recorder* r : recorders_) r->record_event(at->channel, change.event);
  }
}

/// A sink's thread wrote its safe values, for nobody commanded it.
void BenchRun::take_up_made_safe(std::size_t index, const CycleContext& cycle) noexcept {
  RunSink& sink = *parts_.sinks[index];
  const std::uint64_t times = sink.sink->counters().made_safe;
  if (times == sink.made_safe) return;
  sink.made_safe = times;
  if (parts_.expectations) parts_.expectations->made_safe(*sink.port, cycle.t);
  SampleSlot slot = event_pool_->try_acquire();
  if (!slot) return;  // the sink's counters say it all the same
  Sample& sample = *slot;
  sample.stamp = {};
  sample.stamp.sequence = event_sequence_++;
  sample.stamp.t_capture = sample.stamp.t_arrival = sample.stamp.t_release = cycle.t;
  EventInfo info;
  info.code = kEventMadeSafe;
  info.value = static_cast<double>(index);
  EventText(info).add(sink.entry->name).add(" has its safe values: nobody commanded it");
  sample.info = info;
  const SampleLease event = std::move(slot);
  if (live_) live_->event(FaultBench::kNoChannel, event);
  for (Recorder* r : recorders_) r->record_event(FaultBench::kNoChannel, event);
}

void BenchRun::inputs(const CycleContext& cycle) noexcept {
  if (skip_this_cycle_) return;
  if (parts_.faults) take_up_faults(cycle);
  const auto& recorded = parts_.recorded_faults;
  for (std::size_t& i = next_recorded_fault_; i < recorded.size() && recorded[i].t <= cycle.t; ++i)
    if (parts_.expectations) parts_.expectations->fault(recorded[i].of, recorded[i].kind, recorded[i].begins);
  if (live_) take_up_notes(cycle);
  for (std::uint32_t i = 0; i < parts_.channels.size(); ++i) show(*parts_.channels[i], i, cycle);
  parts_.motion.update(cycle.t);
  if (live_ && live_->wants_motion()) live_->motion(parts_.motion.motion_at(cycle.t), cycle.t);
  for (Recorder* r : recorders_)
    if (r->motion_due(cycle.t)) r->record_motion(parts_.motion.motion_at(cycle.t), cycle.t);
}

void BenchRun::take_up_notes(const CycleContext& cycle) noexcept {
  while (SampleLease note = live_->next_note(cycle.t)) {
    live_->event(FaultBench::kNoChannel, note);
    for (Recorder* r : recorders_) r->record_event(FaultBench::kNoChannel, note);
  }
}

void BenchRun::show(RunChannel& c, std::uint32_t index, const CycleContext& cycle) noexcept {
  while (SampleLease sample = c.source->poll(cycle.t)) {
    ++c.taken;
    // What a free-running device measured while the bench was starting is not of this run.
    if (sample->stamp.t_capture < t0_ - c.entry->period) {
      ++c.before_start;
      continue;
    }
    if (!c.pair)
      for (Recorder* r : recorders_) r->record(index, sample);
    if (live_ && !c.pair) live_->sample(std::size_t{2} * index, sample);
    c.port.push(std::move(sample));
  }
  while (SampleLease event = c.source->poll_event()) {
    for (Recorder* r : recorders_) r->record_event(index, event);
    if (live_) live_->event(index, event);
  }
  if (c.script) {
    const auto visible = c.script->at(cycle.index);
    c.port.obey(visible.status, visible.sequence, cycle.t);
  } else {
    c.port.advance(cycle.t, c.source->health().connected);
  }
  if (live_) live_->port(index, c.port, cycle.t);
  const PortStatus status = c.port.status();
  const bool fresh = status == PortStatus::fresh;
  const bool changed = fresh || status != c.last_status;
  const SampleLease& sample = c.port.sample();
  // A recording lists every port in its first cycle: of one that never changes it is known, too, what was
  // seen.
  if (changed || !c.listed)
    for (Recorder* r : recorders_) r->record_visibility(index, cycle.index, cycle.t, status, sample);
  c.listed = true;
  if (!changed) return;

  if (digest_) digest_->saw(cycle.index, cycle.t, index, status, sample);
  if (status != c.last_status && !(fresh && c.last_status == PortStatus::held) &&
      !(status == PortStatus::held && c.last_status == PortStatus::fresh)) {
    if (c.span_count < RunChannel::kKept) c.spans[c.span_count] = {cycle.t, status};
    ++c.span_count;
  }
  c.last_status = status;
  if (!fresh || !sample) return;

  const Stamp& stamp = sample->stamp;
  c.age.record(cycle.t - stamp.t_capture);
  c.arrival.record(stamp.t_arrival - stamp.t_capture);
  if (c.seen && stamp.sequence > c.last_sequence + 1) {
    if (c.gap_count < RunChannel::kKept)
      c.gaps[c.gap_count] = {cycle.t, c.last_sequence, stamp.sequence - c.last_sequence - 1};
    ++c.gap_count;
  }
  if (!c.seen) {
    c.t_first = stamp.t_capture;
    if (sample->kind() == SampleKind::image) c.first_image = sample;
  }
  c.t_last = stamp.t_capture;
  c.last_sequence = stamp.sequence;
  c.seen = true;
}

void BenchRun::capture(const CycleContext& cycle) noexcept {
  for (auto& c : parts_.channels)
    if (c->pair)
      for (; c->next_switch < c->entry->switches.size() &&
             t0_ + c->entry->switches[c->next_switch].after_start <= cycle.t;
           ++c->next_switch)
        c->pair->switch_to(c->entry->switches[c->next_switch].to_real ? PairSide::real : PairSide::simulated);
  for (auto& channel : parts_.channels) channel->source->begin_cycle(cycle.t);
}

void BenchRun::application(const CycleContext& cycle) noexcept {
  if (skip_this_cycle_) return;
  run_application(cycle);
  take_up_bridged_commands(cycle);
}

void BenchRun::run_application(const CycleContext& cycle) noexcept {
  if (!parts_.application) return;
  parts_.application->step(cycle.index, cycle.t);
  if (parts_.application->failed()) executive_.fail_run(StopReason::application);
}

/// After the application: of two who command a sink in one cycle, the program outside has the last word.
void BenchRun::take_up_bridged_commands(const CycleContext& cycle) noexcept {
  for (const auto& bridge : parts_.bridges)
    for (BridgeCommand command; bridge->bridge->poll(cycle.t, command);)
      (void)parts_.sinks[command.sink]->port->send(cycle.t, std::span(command.value).first(command.count));
}

void BenchRun::note_differences(const CycleContext& cycle) noexcept {
  for (auto& c : parts_.channels) {
    if (!c->pair || c->difference_count >= RunChannel::kKept) continue;
    const PairSnapshot s = c->pair->statistics();
    if (s.compared > 0)
      c->differences[c->difference_count++] = {(cycle.t - t0_).seconds(), s.last.bias, s.last.sigma};
  }
}

void BenchRun::outputs(const CycleContext& cycle) noexcept {
  if (cycle.index >= next_note_) {
    note_differences(cycle);
    next_note_ = cycle.index + note_every_;
  }
  for (std::uint32_t i = 0; i < parts_.sinks.size(); ++i) {
    take_up_made_safe(i, cycle);
    if (const Command* command = parts_.sinks[i]->port->take_new()) {
      for (Recorder* r : recorders_) r->record_command(i, *command);
      if (live_) live_->command(i, *command);
      if (parts_.expectations) parts_.expectations->command(*parts_.sinks[i]->port, *command);
    }
  }
  if (parts_.expectations && !skip_this_cycle_) parts_.expectations->cycle(cycle.t);
  for (Recorder* r : recorders_) r->end_cycle(cycle.index, cycle.t);
  if (!recorder_) return;
  // A run that was to be recorded is over when it cannot be.
  if (recorder_->failed()) executive_.fail_run(StopReason::recording);
}

}  // namespace rigor
