#include "bench/bench.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <atomic>
#include <ctime>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/control/fault_control.h"
#include "bench/devices/emulator_process.h"
#include "bench/expect/expected_forms.h"
#include "bench/live/live_view.h"
#include "bench/report/report.h"
#include "bench/report/typed_command.h"
#include "bench/result/collect_report.h"
#include "bench/result/run_facts.h"
#include "bench/run/bridges.h"
#include "bench/run/recording.h"
#include "bench/run/replay_assembly.h"
#include "bench/run/run_json.h"
#include "rt-core/affinity.h"
#include "rt-core/trace.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/plugin/plugin.h"

namespace rigor {
namespace {

/// "2000 cycles, 0 skipped, 0 misses  left 50 LOST (-3)  right 50".
std::string status_text(const BenchRun& run, const RunParts& parts, double t_s) {
  const LoopCounters& n = run.counters();
  std::string line =
      fmt::format("{} cycles, {} skipped, {} misses", n.run.load(), n.skipped.load(), n.misses.load());
  for (const auto& c : parts.channels) {
    const HealthSnapshot h = c->source->health();
    // Before the run begins nothing is there that could be lost.
    const bool gone = !h.connected && t_s > 0;
    line += fmt::format("  {} {}{}", c->entry->name, h.received, gone ? " LOST" : "");
    if (const auto lost = h.lost) line += fmt::format(" (-{})", lost);
  }
  return line;
}

std::string iso(RealtimeTime t) {
  const std::time_t s = t.ns() / 1'000'000'000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(s), t.ns() / 1'000'000 % 1000);
}

/// `t0`: of the run; in virtual time, whose trace has the instants of the computer, none.
std::string trace_warning(const std::filesystem::path& file, std::uint64_t dropped, std::int64_t since_ns,
                          BenchTime t0) {
  const std::string when =
      t0.ns() > 0 ? fmt::format(" {:.1f} s into the run", static_cast<double>(since_ns - t0.ns()) * 1e-9)
                  : "";
  return fmt::format("{}: the trace was full{}: {} events are not in it; trace a shorter run (--duration)",
                     file.string(), when, dropped);
}

}  // namespace

struct Bench::Impl {
  BenchOptions options;
  Registry registry;
  std::optional<ReplayInput> replay;
  std::unique_ptr<Assembly> assembly;
  std::optional<EmulatorProcess> emulators;
  std::optional<Trace> trace;
  std::optional<BenchRun> run;
  std::optional<CrashGuard> guard;
  ControlCommands commands;
  std::unique_ptr<ControlSocket> control;
  std::optional<live::LiveView> view;
  std::optional<RecordingFile> file;
  std::unique_ptr<Recorder> recorder;
  std::vector<std::unique_ptr<PairObserver>> pair_observers;  ///< where there are bridges
  std::vector<std::string> warnings;
  EpochPair epoch;
  std::atomic<bool> prepared{false};  ///< faults may be injected: other threads read it
  bool started = false;

  Impl(BenchOptions o, const Registry& r) : options(std::move(o)), registry(r) {}
  ~Impl() {
    if (started) file.reset();  // what there is of the recording stays
    abandon();
  }

  [[nodiscard]] RunParts& parts() { return assembly->parts; }
  [[nodiscard]] const RigConfig& rig() const { return assembly->parts.rig; }
  [[nodiscard]] bool virtual_time() const { return rig().clock == ClockKind::virtual_time; }
  [[nodiscard]] Existing existing() const { return options.replace ? Existing::replace : Existing::keep; }
  [[nodiscard]] std::string engine() const {
    return assembly->simulation ? assembly->simulation->engine() : "";
  }
  /// Threads that are made while it lives leave the loop's CPU alone.
  [[nodiscard]] AvoidCpu off_the_loops_cpu() {
    return AvoidCpu(virtual_time() ? -1 : loop_cpu(run->executive().config().realtime));
  }

  Status check_outputs(const RigConfig& wanted) const;
  Status check_analyses() const;
  Status prepare(StopToken stop);
  Result<RunOutcome> run_in_wall_clock_time(StopToken stop);
  Status start_virtual();
  Result<RunOutcome> run_in_virtual_time(StopToken stop);
  Result<RunReport> close(Result<RunOutcome> outcome);
  void warn(std::string text);
  /// As the control socket would, whose thread may ask at the same time.
  Status ask(const nlohmann::json& request);
  Error broke_off(const std::exception& e);
  void analyse(RunReport& report) const;
  void write_files(RunReport& report);
  void abandon();
};

void Bench::Impl::warn(std::string text) {
  if (std::ranges::find(warnings, text) != warnings.end()) return;
  if (options.on_warning) options.on_warning(text);
  warnings.push_back(std::move(text));
}

Status Bench::Impl::ask(const nlohmann::json& request) {
  if (!prepared)
    return fail(ErrorCode::wrong_state, rig().name,
                "faults are injected between prepare() and the end of the run");
  if (!parts().faults)
    return fail(ErrorCode::wrong_state, rig().name, "a replay has the faults of its recording alone");
  const auto result = commands.ask(request);
  return result ? Status{} : tl::unexpected<Error>(result.error());
}

/// A source threw: the devices are closed, and what there is of the recording stays.
Error Bench::Impl::broke_off(const std::exception& e) {
  prepared = started = false;
  if (recorder) (void)recorder->stop();
  recorder.reset();
  file.reset();
  abandon();
  return {ErrorCode::internal, rig().name, std::string("the run broke off: ") + e.what()};
}

/// Nothing came of the run: its devices are closed, and an earlier recording has its name back.
void Bench::Impl::abandon() {
  view.reset();
  control.reset();
  if (run) {
    run->set_live(nullptr);
    (void)run->stop();
  }
  std::vector<Error> lost;
  if (assembly) close_bridges(parts(), lost);
  if (recorder) (void)recorder->stop();
  recorder.reset();
  if (file) file->abandon();
  file.reset();
}

Status Bench::Impl::check_outputs(const RigConfig& wanted) const {
  InputFiles inputs;
  inputs.add_rig(wanted);
  inputs.add("the recording of --faults-from", options.faults_from);
  if (replay) inputs.add("the recording that is replayed", replay->file);
  return check_run_outputs(wanted, registry, {{options.trace, "--trace"}, {options.junit, "--junit"}},
                           std::move(inputs), existing(), replay.has_value());
}

Status Bench::Impl::check_analyses() const {
  ApplicationPorts ports;
  for (const ChannelEntry& c : rig().channels) ports.inputs[c.name] = {};
  for (const SinkEntry& s : rig().sinks) ports.outputs[s.name] = nullptr;
  for (const AnalysisChoice& choice : rig().analyses) {
    const NamedAnalysis* known = registry.find_analysis(choice.name);
    if (!known) {
      const auto names = registry.analysis_names();
      return tl::unexpected<Error>(
          choice.params
              .error("", fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "), choice.name,
                                     did_you_mean(choice.name, names)))
              .error());
    }
    const auto checked = catch_config([&] { return known->check(choice.params, ports); });
    if (!checked) return tl::unexpected<Error>(checked.error());
    if (!*checked) return *checked;
  }
  return {};
}

Status Bench::Impl::prepare(StopToken stop) {
  if (auto s = prepare_outputs(rig(), registry, existing(), replay.has_value()); !s) return s;
  if (!virtual_time() && rig().start_emulators && options.start_emulators && !rig().emulators.empty()) {
    const ProgressTask coming("bring up the emulators");
    auto up = EmulatorProcess::start(rig().file, rig().overrides, seconds(300), stop);
    if (!up) return tl::unexpected<Error>(up.error());
    emulators.emplace(std::move(*up));
    parts().emulators = &*emulators;
  }
  if (!options.trace.empty()) trace.emplace();
  run.emplace(parts(), trace ? &*trace : nullptr);
  run->want_digest(options.digest.value_or(virtual_time() || !rig().record.file.empty()));
  if (replay) run->set_cycle_filter([this](std::uint64_t cycle) { return replay->recording->ran(cycle); });
  if (!virtual_time()) guard.emplace(run->heartbeat());
  {
    const ProgressTask arming("arm the channels");
    if (auto s = run->arm(stop); !s) return s;
  }
  for (std::string& w : run->warnings()) warn(std::move(w));
  for (const std::string& f : run->forecasts())
    if (options.on_warning) options.on_warning(f);
  epoch = replay ? replay->run.epoch : virtual_time() ? kVirtualEpoch : read_epoch();
  if (!replay || options.live) add_run_commands(commands, parts());
  if (options.live)
    view.emplace(*options.live,
                 live::LiveView::Context{parts(), run->counters(), commands, assembly->simulation.get(),
                                         epoch, replay.has_value()});
  run->set_live(view ? &view->tap() : nullptr);
  run->set_pace(options.pace);
  if (options.control) {
    const AvoidCpu rest = off_the_loops_cpu();
    auto opened = ControlSocket::open(rig().name, commands);
    if (opened)
      control = std::move(*opened);
    else
      warn("no `rigor fault` for this run: " + opened.error().text());
  }
  if (!rig().record.file.empty()) {
    auto made = RecordingFile::create(rig().record.file, existing());
    if (!made) return tl::unexpected<Error>(made.error());
    file.emplace(std::move(*made));
    const AvoidCpu rest = off_the_loops_cpu();
    auto opened = open_recording(parts(), *file, epoch, {{"renderer", engine()}});
    if (!opened) return tl::unexpected<Error>(opened.error());
    recorder = std::move(*opened);
  }
  {
    const AvoidCpu rest = off_the_loops_cpu();
    if (auto s = open_bridges(parts(), epoch); !s) return s;
  }
  run->set_recorder(recorder.get());
  if (view) view->attach(recorder.get());
  std::vector<PairObserver*> first;
  for (std::size_t i = 0; i < parts().channels.size(); ++i) {
    PairObserver* recording = recorder ? recorder->observer(static_cast<std::uint32_t>(i)) : nullptr;
    first.push_back(view ? view->tap().observer(i, recording) : recording);
  }
  pair_observers = observe_for_bridges(parts(), first);
  {
    std::optional<ProgressTask> waiting;
    if (!parts().bridges.empty()) waiting.emplace("wait for the peers of the bridges");
    if (auto s = wait_for_peers(parts(), stop); !s) return s;
  }
  prepared = true;
  return {};
}

Result<RunOutcome> Bench::Impl::run_in_wall_clock_time(StopToken stop) {
  std::optional<ProgressTask> progress;
  {
    const AvoidCpu rest = off_the_loops_cpu();
    progress.emplace("run", rig().duration.seconds(), "s");
  }
  const auto run_s = [this] {
    return std::max(0.0, (bench_now() - run->t0().value_or(BenchTime::never())).seconds());
  };
  progress->follow(run_s, [&] { return status_text(*run, parts(), run_s()); });
  auto outcome = run->run(stop);
  if (outcome && outcome->loop.reason == StopReason::finished) progress->finish();
  return outcome;
}

Status Bench::Impl::start_virtual() { return run->begin(replay ? replay->run.t0 : BenchTime(0)); }

Result<RunOutcome> Bench::Impl::run_in_virtual_time(StopToken stop) {
  if (auto s = start_virtual(); !s) return tl::unexpected<Error>(s.error());
  ProgressTask progress(replay ? "replay" : "run", rig().duration.seconds(), "s");
  const auto run_s = [this] {
    return static_cast<double>(run->counters().cycle.load()) * rig().loop.period.seconds();
  };
  progress.follow(run_s, [&] { return status_text(*run, parts(), run_s()); });
  while (run->advance(1u << 20, stop)) {
  }
  RunOutcome outcome = run->end();
  if (outcome.loop.reason == StopReason::finished) progress.finish();
  return outcome;
}

void Bench::Impl::analyse(RunReport& report) const {
  for (const AnalysisChoice& choice : rig().analyses) {
    auto found = registry.find_analysis(choice.name)->run(choice.params, rig().record.file);
    if (!found)
      report.errors.push_back(found.error());
    else if (*found)
      report.analyses.push_back(std::move(**found));
  }
}

void Bench::Impl::write_files(RunReport& report) {
  const auto written = [&](const Status& s, std::filesystem::path& to, const std::filesystem::path& name) {
    if (s)
      to = name;
    else
      report.errors.push_back(s.error());
  };
  const auto keep = [this](const std::filesystem::path& name) -> Status {
    if (existing() != Existing::keep) return {};
    const auto kept = keep_earlier(name);
    return kept ? Status{} : tl::unexpected<Error>(kept.error());
  };
  if (!rig().report.empty()) {
    const ProgressTask writing("write the report");
    written(write_report(rig().report, report, parts(), existing()), report.page,
            rig().report / "index.html");
  }
  if (trace) {
    Status s = keep(options.trace);
    if (s)
      s = write_output(options.trace,
                       [&](const std::filesystem::path& part) { return trace->write(part.string()); });
    written(s, report.trace, options.trace);
  }
  if (!options.junit.empty()) {
    std::string failure = report.ended_well() ? "" : to_string(report.outcome.loop.reason);
    for (const Error& e : report.errors) failure += (failure.empty() ? "" : "; ") + e.text();
    Status s = keep(options.junit);
    if (s)
      s = write_output(options.junit,
                       junit_text(report.expected, rig().name, failure, report.outcome.wall_s));
    written(s, report.junit, options.junit);
  }
}

Result<RunReport> Bench::Impl::close(Result<RunOutcome> outcome) {
  prepared = started = false;
  const bool stays = view && options.live_stays && outcome && outcome->loop.reason == StopReason::finished;
  if (stays)
    view->ended();
  else
    view.reset();
  run->set_live(nullptr);
  control.reset();
  // What came up during the run: devices that refused, clocks that did not settle.
  for (std::string& w : run->warnings()) warn(std::move(w));
  if (trace)
    if (const auto since_ns = trace->full_since_ns())
      warn(trace_warning(options.trace, trace->dropped(), *since_ns,
                         virtual_time() ? BenchTime{} : run->t0().value_or(BenchTime{})));
  std::optional<ProgressTask> closing(std::in_place, "close the devices and the recording");
  const Status finished = parts().application ? parts().application->finish() : Status{};
  const Status stopped = run->stop();
  Status recorded;
  if (recorder) {
    if (outcome) recorder->add_closing_metadata({{kInputDigestKey, outcome->input_sha256}});
    recorded = recorder->stop();
  }
  std::vector<Error> unbridged;
  close_bridges(parts(), unbridged);
  closing.reset();
  if (!outcome) {
    abandon();
    return tl::unexpected<Error>(outcome.error());
  }

  RunReport report;
  report.outcome = std::move(*outcome);
  for (const Status* s : {static_cast<const Status*>(&recorded), &stopped, &finished})
    if (!*s) report.errors.push_back(s->error());
  for (Error& e : unbridged) report.errors.push_back(std::move(e));
  report.identity = identity_of(rig());
  report.identity.renderer = engine();
  report.identity.utc = iso(epoch.to_utc(report.outcome.t0));
  report.identity.command = typed_command();
  report.identity.machine = machine_name();
  report.identity.virtual_epoch = virtual_time() && !replay;
  report.facts = ended_run_facts(parts(), report.outcome, recorder.get(), warnings);
  if (parts().expectations) {
    RunEnd end = run_end(report.facts);
    end.loop = &report.outcome.loop;
    report.expected = parts().expectations->finish(end);
  }
  for (const Expected& e : report.expected)
    if (e.fails()) report.facts.unmet.push_back(e.sentence());
  report.verdict = judge(report.facts);
  report.fail_on = options.fail_on;
  report.failed_on = report.verdict.found(options.fail_on);
  report.warnings = warnings;
  if (replay && !replay->run.input_sha256.empty() && report.outcome.loop.reason == StopReason::finished &&
      report.outcome.input_sha256 != replay->run.input_sha256)
    report.replay_difference = "the application saw something else than in the recorded run (" +
                               replay->run.input_sha256 + "); the rig or the file was changed";
  collect_parts(parts(), recorder.get(), report);
  if (recorder && recorded) {
    report.recording = rig().record.file;
    analyse(report);
  }
  write_files(report);
  recorder.reset();
  file.reset();
  return report;
}

Bench::Bench(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Bench::~Bench() = default;

Result<std::unique_ptr<Bench>> Bench::create(RigConfig rig, const Registry& registry, BenchOptions options) {
  auto impl = std::make_unique<Impl>(std::move(options), registry);
  // All that can be refused is refused before a device or a file is touched.
  if (auto s = load_plugins(rig.plugins, impl->registry); !s) return tl::unexpected<Error>(s.error());
  if (auto s = impl->check_outputs(rig); !s) return tl::unexpected<Error>(s.error());
  auto assembly = assemble(std::move(rig), impl->registry);
  if (!assembly) return tl::unexpected<Error>(assembly.error());
  impl->assembly = std::move(*assembly);
  if (auto s = impl->check_analyses(); !s) return tl::unexpected<Error>(s.error());
  if (const auto& from = impl->options.faults_from; !from.empty())
    if (auto s = schedule_recorded_faults(from, impl->rig(), *impl->parts().faults); !s)
      return tl::unexpected<Error>(s.error());
  return std::unique_ptr<Bench>(new Bench(std::move(impl)));
}

Result<std::unique_ptr<Bench>> Bench::create_replay(RigConfig rig, const Registry& registry,
                                                    ReplayInput input, BenchOptions options) {
  auto impl = std::make_unique<Impl>(std::move(options), registry);
  impl->replay = std::move(input);
  if (auto s = load_plugins(rig.plugins, impl->registry); !s) return tl::unexpected<Error>(s.error());
  if (auto s = impl->check_outputs(rig); !s) return tl::unexpected<Error>(s.error());
  auto assembly = assemble_replay(std::move(rig), impl->registry, *impl->replay);
  if (!assembly) return tl::unexpected<Error>(assembly.error());
  impl->assembly = std::move(*assembly);
  if (auto s = impl->check_analyses(); !s) return tl::unexpected<Error>(s.error());
  return std::unique_ptr<Bench>(new Bench(std::move(impl)));
}

Result<std::unique_ptr<Bench>> Bench::create_replay(const std::filesystem::path& recording,
                                                    const Registry& registry, BenchOptions options,
                                                    const std::vector<ConfigOverride>& overrides) {
  auto input = open_replay(recording);
  if (!input) return tl::unexpected<Error>(input.error());
  auto rig = recorded_rig(*input, overrides, registry, false);
  if (!rig) return tl::unexpected<Error>(rig.error());
  rig->clock = ClockKind::virtual_time;
  return create_replay(std::move(*rig), registry, std::move(*input), std::move(options));
}

Status Bench::prepare(StopToken stop) {
  if (impl_->run) return fail(ErrorCode::wrong_state, rig().name, "prepare() comes once");
  auto s = impl_->prepare(stop);
  if (!s) impl_->abandon();
  return s;
}

Result<RunReport> Bench::run(StopToken stop) {
  if (!impl_->prepared || impl_->started)
    return fail(ErrorCode::wrong_state, rig().name, "run() comes once, after prepare()");
  impl_->started = true;
  try {
    return impl_->close(impl_->virtual_time() ? impl_->run_in_virtual_time(stop)
                                              : impl_->run_in_wall_clock_time(stop));
  } catch (const std::exception& e) {
    return tl::unexpected<Error>(impl_->broke_off(e));
  }
}

Status Bench::start() {
  if (!impl_->prepared || impl_->started || !impl_->virtual_time())
    return fail(
        ErrorCode::wrong_state, rig().name,
        "start() comes once, after prepare(), for a rig in virtual time; in wall-clock time there is run()");
  if (auto s = impl_->start_virtual(); !s) {
    impl_->abandon();
    impl_->prepared = false;
    return s;
  }
  impl_->started = true;
  return {};
}

Result<bool> Bench::step(std::uint64_t cycles, StopToken stop) {
  if (!impl_->started) return fail(ErrorCode::wrong_state, rig().name, "step() comes after start()");
  try {
    return impl_->run->advance(cycles, stop);
  } catch (const std::exception& e) {
    return tl::unexpected<Error>(impl_->broke_off(e));
  }
}

Result<RunReport> Bench::finish() {
  if (!impl_->started) return fail(ErrorCode::wrong_state, rig().name, "finish() comes once, after start()");
  return impl_->close(impl_->run->end());
}

const RigConfig& Bench::rig() const noexcept { return impl_->rig(); }
const ApplicationPorts& Bench::ports() const noexcept {
  static const ApplicationPorts none;
  return impl_->run ? impl_->run->ports() : none;
}

Status Bench::inject_fault(const std::string& channel, const FaultSpec& fault) {
  return impl_->ask(
      {{"command", "fault"}, {"channel", channel}, {"fault", nlohmann::json::parse(fault_json(fault))}});
}
Status Bench::inject_fault(const std::string& channel, const std::string& fault) {
  const auto node = ConfigDocument::parse(fault, "the fault");
  if (!node) return tl::unexpected<Error>(node.error());
  return impl_->ask(
      {{"command", "fault"}, {"channel", channel}, {"fault", nlohmann::json::parse(node->json())}});
}

Status Bench::clear_faults(const std::string& channel) {
  nlohmann::json request{{"command", "clear"}};
  if (!channel.empty()) request["channel"] = channel;
  return impl_->ask(request);
}

Status Bench::switch_pair(const std::string& channel, const std::string& active) {
  return impl_->ask({{"command", "switch"}, {"channel", channel}, {"active", active}});
}

Status Bench::command(const std::string& sink, std::span<const double> values) {
  if (!impl_->started)
    return fail(ErrorCode::wrong_state, rig().name, "command() comes between steps, after start()");
  const auto& outputs = ports().outputs;
  const auto found = outputs.find(sink);
  if (found == outputs.end()) {
    std::vector<std::string> names;
    for (const auto& [name, port] : outputs) names.push_back(name);
    return fail(ErrorCode::bad_input, sink,
                fmt::format("expected a sink of this rig ({}), got \"{}\"{}", fmt::join(names, ", "), sink,
                            did_you_mean(sink, names)));
  }
  const auto& names = found->second->describe().names;
  if (values.size() != names.size())
    return fail(
        ErrorCode::bad_input, sink,
        fmt::format("expected {} values ({}), got {}", names.size(), fmt::join(names, ", "), values.size()));
  if (!found->second->send(impl_->run->next_cycle_time(), values))
    return fail(ErrorCode::unavailable, sink, "the sink's queue is full: step the bench between commands");
  return {};
}

std::vector<Expected> Bench::expected() const {
  if (!impl_->started || !impl_->parts().expectations) return {};
  Expectations& expectations = *impl_->parts().expectations;
  expectations.show();
  std::vector<ChannelCounts> counts;
  for (const auto& c : impl_->parts().channels) counts.push_back(counts_of(*c));
  const LoopCounters& n = impl_->run->counters();
  const LoopCounts loop{impl_->run->t0().value_or(BenchTime{}), impl_->run->next_cycle_time(), n.run.load(),
                        n.skipped.load(), n.misses.load()};
  RunEnd known = run_end(run_facts(impl_->parts(), loop, counts));
  known.extent = RunEnd::Extent::so_far;
  known.skipped = loop.skipped;
  known.misses = loop.misses;
  return expectations.so_far(known);
}

std::uint64_t Bench::cycle() const noexcept { return impl_->run ? impl_->run->counters().cycle.load() : 0; }

}  // namespace rigor
