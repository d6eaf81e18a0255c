#include "cli/execute.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "apps/forest-localization/stem_map.h"
#include "bench/analysis/localization_error.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/control/fault_control.h"
#include "bench/live/live_view.h"
#include "bench/report/report.h"
#include "bench/report/typed_command.h"
#include "bench/result/run_result.h"
#include "bench/run/recording.h"
#include "rt-core/affinity.h"
#include "rt-core/trace.h"

namespace rigor {
namespace {

/// "2000 cycles, 0 skipped, 0 misses  left 50 LOST (-3)  right 50".
std::string status_text(const BenchRun& run, const RunParts& parts, double t_s) {
  const LoopCounters& n = run.counters();
  std::string line =
      fmt::format("{} cycles, {} skipped, {} misses", n.run.load(), n.skipped.load(), n.misses.load());
  for (const auto& c : parts.channels) {
    const Health& h = c->source->health();
    // Before the run begins nothing is there that could be lost.
    const bool gone = !h.connected.load() && t_s > 0;
    line += fmt::format("  {} {}{}", c->entry->name, h.received.load(), gone ? " LOST" : "");
    if (const auto lost = h.lost.load()) line += fmt::format(" (-{})", lost);
  }
  return line;
}

/// Seconds of the run that are over, as its clock counts.
double run_s(const BenchRun& run, const RunParts& parts, BenchTime t0) {
  return parts.rig.clock == ClockKind::wall
             ? std::max(0.0, (bench_now() - t0).seconds())
             : static_cast<double>(run.counters().cycle.load()) * parts.rig.loop.period.seconds();
}

std::string iso(RealtimeTime t) {
  const std::time_t s = t.ns() / 1'000'000'000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(s), t.ns() / 1'000'000 % 1000);
}

/// Of a run that records a channel `truth` and a sink `estimate`.
std::optional<LocalizationError> localization_of(const RunParts& parts) {
  const auto named = [](const char* name) {
    return [name](const auto& c) { return c->entry->name == name; };
  };
  if (parts.rig.record.file.empty() || std::ranges::none_of(parts.channels, named("truth")) ||
      std::ranges::none_of(parts.sinks, named("estimate")))
    return std::nullopt;
  auto error = localization_error(parts.rig.record.file, {});
  if (!error) return std::nullopt;  // of other kinds, or none was told
  return std::move(*error);
}
/// What the application knows of stems, for the drawing.
std::vector<DrawnStem> stems_of(const RigConfig& rig) {
  std::vector<DrawnStem> stems;
  (void)catch_config([&] {
    const ConfigNode map = rig.application_params.map_or_absent("map");
    if (!map.has("file")) return true;
    if (const auto known = forest::StemMap::load(map.base_dir() / map.text("file")))
      for (const forest::Stem& s : known->stems()) stems.push_back({s.x_m, s.y_m, s.radius_m});
    return true;
  });
  return stems;
}

Status write_junit(const std::vector<Expected>& expected, const RunParts& parts, const RunOutcome& outcome,
                   const std::string& failure, const ExecuteOptions& options) {
  if (options.existing == Existing::keep)
    if (const auto kept = keep_earlier(options.junit); !kept) return tl::unexpected<Error>(kept.error());
  return write_output(options.junit, junit_text(expected, parts.rig.name, failure, outcome.wall_s));
}

Status write_trace(const Trace& trace, const ExecuteOptions& options) {
  if (options.existing == Existing::keep)
    if (const auto kept = keep_earlier(options.trace); !kept) return tl::unexpected<Error>(kept.error());
  return write_output(options.trace,
                      [&](const std::filesystem::path& part) { return trace.write(part.string()); });
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

int execute(Assembly& assembly, const ExecuteOptions& options, StopToken stop) {
  RunParts& parts = assembly.parts;
  const bool virtual_time = parts.rig.clock == ClockKind::virtual_time;
  std::optional<Trace> trace;
  if (!options.trace.empty()) trace.emplace();

  BenchRun run(parts, trace ? &*trace : nullptr);
  if (options.ran) run.set_cycle_filter(options.ran);
  const CrashGuard guard(run.heartbeat());
  {
    const ProgressTask arming("arm the channels");
    if (auto s = run.arm(stop); !s) return report_error(s.error(), options.json);
  }
  std::vector<std::string> warnings = run.warnings();
  for (const std::string& w : warnings) write_stderr(fmt::format("rigor: warning: {}\n", w));
  const EpochPair epoch = options.epoch ? *options.epoch : virtual_time ? kVirtualEpoch : read_epoch();
  const std::string engine = assembly.simulation ? assembly.simulation->engine() : "";
  ControlCommands commands;
  std::unique_ptr<ControlSocket> control;
  if (options.control || options.live) add_run_commands(commands, parts);
  std::optional<live::LiveView> view;
  if (options.live)
    view.emplace(*options.live,
                 live::LiveView::Context{parts, run.counters(), commands, assembly.simulation.get(), epoch,
                                         static_cast<bool>(options.ran)});
  run.set_live(view ? &view->tap() : nullptr);
  run.set_pace(options.pace);
  if (options.control) {
    const AvoidCpu rest(virtual_time ? -1 : loop_cpu(run.executive().config().realtime));
    auto opened = ControlSocket::open(parts.rig.name, commands);
    if (opened)
      control = std::move(*opened);
    else
      warnings.push_back("no `rigor fault` for this run: " + opened.error().text()),
          fmt::print(stderr, "rigor: warning: {}\n", warnings.back());
  }
  BenchTime t0;
  std::optional<RecordingFile> file;
  if (!parts.rig.record.file.empty()) {
    auto made = RecordingFile::create(parts.rig.record.file, options.existing);
    if (!made) return report_error(made.error(), options.json);
    file.emplace(std::move(*made));
  }
  std::unique_ptr<Recorder> recorder;
  Result<RunOutcome> outcome = fail(ErrorCode::internal, "run", "did not run");
  // All channels are started with the grid of a t0 that lies ahead. How long that takes is known afterwards:
  // where t0 has passed by then, they are started once more, with more time.
  for (Duration lead = seconds(1);; lead = lead * 4) {
    t0 = options.t0 ? *options.t0 : virtual_time ? BenchTime(0) : bench_now() + lead;
    auto opened = [&]() -> Result<std::unique_ptr<Recorder>> {
      if (!file) return std::unique_ptr<Recorder>{};
      const AvoidCpu rest(virtual_time ? -1 : loop_cpu(run.executive().config().realtime));
      return open_recording(parts, *file, t0, epoch, {{"engine", engine}});
    }();
    if (!opened) {
      file->abandon();
      return report_error(opened.error(), options.json);
    }
    run.set_recorder(opened->get());
    if (view) view->attach(opened->get(), t0);
    {
      std::optional<ProgressTask> progress;
      {
        const AvoidCpu rest(virtual_time ? -1 : loop_cpu(run.executive().config().realtime));
        progress.emplace(options.ran ? "replay" : "run", parts.rig.duration.seconds(), "s");
      }
      progress->follow([&] { return run_s(run, parts, t0); },
                       [&] { return status_text(run, parts, run_s(run, parts, t0)); });
      outcome = run.run(stop, t0);
      if (outcome && outcome->loop.reason == StopReason::finished) progress->finish();
    }
    const bool again = !outcome && run.started_late() && lead < seconds(10) && !stop.stop_requested();
    if (!again) {
      recorder = std::move(*opened);
      break;
    }
    if (auto s = run.arm_again(stop); !s) {
      if (file) file->abandon();
      return report_error(s.error(), options.json);
    }
    if (*opened) (void)(*opened)->stop();  // nothing is in it; the next attempt writes the file anew
  }
  const bool stays = view && options.live_stays && outcome && outcome->loop.reason == StopReason::finished;
  if (stays)
    view->ended();
  else
    view.reset();
  run.set_live(nullptr);
  control.reset();
  // What came up during the run: devices that refused, clocks that did not settle.
  std::vector<std::string> late_warnings = run.warnings();
  if (trace)
    if (const auto since_ns = trace->full_since_ns())
      late_warnings.push_back(
          trace_warning(options.trace, trace->dropped(), *since_ns, virtual_time ? BenchTime{} : t0));
  for (std::string& w : late_warnings) {
    if (std::find(warnings.begin(), warnings.end(), w) != warnings.end()) continue;
    write_stderr(fmt::format("rigor: warning: {}\n", w));
    warnings.push_back(std::move(w));
  }
  std::optional<ProgressTask> closing(std::in_place, "close the devices and the recording");
  const Status finished = parts.application ? parts.application->finish() : Status{};
  const Status stopped = run.stop();
  Status recorded;
  if (recorder) {
    if (outcome) recorder->add_closing_metadata({{"seen_sha256", outcome->seen_sha256}});
    recorded = recorder->stop();
  }
  closing.reset();
  if (!outcome) {
    if (file) file->abandon();
    return report_error(outcome.error(), options.json);
  }

  RunContextText text;
  text.engine = engine;
  text.utc = iso(epoch.to_utc(t0));
  text.recording = parts.rig.record.file.string();
  text.command = typed_command();
  text.machine = machine_name();
  text.virtual_epoch = virtual_time && !options.epoch;
  RunFacts facts = ended_run_facts(parts, *outcome, recorder.get(), warnings);
  std::vector<Expected> expected;
  if (parts.expectations) {
    RunEnd end = run_end(facts);
    end.loop = &outcome->loop;
    expected = parts.expectations->finish(end);
  }
  for (const Expected& e : expected)
    if (!e.holds) facts.unmet.push_back(e.sentence());
  const Verdict verdict = judge(facts);
  const FindingSet failed_on = verdict.found(options.fail_on);
  nlohmann::json result = run_result(parts, *outcome, recorder.get(), text, facts, verdict);
  if (!options.fail_on.empty())
    result["verdict"].update({{"fail_on", options.fail_on.names()}, {"failed_on", failed_on.names()}});
  if (!expected.empty()) result["expect"] = to_json(expected);
  std::string localization;
  if (recorder && recorded)
    if (const auto error = localization_of(parts)) {
      result["localization"] = to_json(*error);
      result["localization"]["text"] = to_text(*error);
      if (!parts.rig.report.empty()) localization = localization_section(*error, stems_of(parts.rig));
    }
  Status reported;
  if (!parts.rig.report.empty()) {
    const ProgressTask writing("write the report");
    reported = write_report(parts.rig.report, result, parts, localization, options.existing);
  }
  if (reported && trace) reported = write_trace(*trace, options);
  if (options.json) {
    fmt::print("{}\n", result.dump());
  } else {
    fmt::print("{}", summary_text(result));
    if (reported && !parts.rig.report.empty())
      fmt::print("report    {}\n", (parts.rig.report / "index.html").string());
    if (reported && trace) fmt::print("trace     {}\n", options.trace.string());
  }
  int status = 0;
  if (!options.expected_sha256.empty() && outcome->loop.reason == StopReason::finished &&
      outcome->seen_sha256 != options.expected_sha256)
    status = report_error({ErrorCode::internal, "replay",
                           "the application saw something else than in the recorded run (" +
                               options.expected_sha256 + "); the rig or the file was changed"},
                          false);
  for (const Status* s :
       {static_cast<const Status*>(&recorded), static_cast<const Status*>(&reported), &stopped, &finished})
    if (!*s) status = 1, report_error(s->error(), false);
  for (const Finding& f : verdict.findings)
    if (!f.kinds.both(failed_on).empty())
      status = 1, fmt::print(stderr, "rigor: failed by --fail-on {}: {}\n",
                             fmt::join(f.kinds.both(failed_on).names(), ","), f.sentence);
  // What was to be tested was not there.
  if (!facts.emulators.empty()) status = 1;
  if (stays) {
    std::fflush(stdout);
    write_stderr(fmt::format("live      {} stays until Ctrl-C\n", options.live->url()));
    while (!stop.stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  for (const Expected& e : expected)
    if (!e.holds) status = 1, fmt::print(stderr, "rigor: not as expected: {}\n", e.sentence());
  const StopReason reason = outcome->loop.reason;
  const bool aborted = reason == StopReason::overrun || reason == StopReason::failed ||
                       reason == StopReason::recording || reason == StopReason::application;
  if (!options.junit.empty()) {
    std::string failure = aborted ? to_string(reason) : "";
    if (!finished) failure += (failure.empty() ? "" : "; ") + finished.error().text();
    if (auto s = write_junit(expected, parts, *outcome, failure, options); !s)
      status = report_error(s.error(), false);
  }
  return aborted ? 1 : status;
}

}  // namespace rigor
