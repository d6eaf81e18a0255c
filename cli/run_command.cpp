#include <fmt/chrono.h>
#include <fmt/format.h>

#include <atomic>
#include <chrono>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "cli/assembly.h"
#include "cli/backends.h"
#include "cli/commands.h"
#include "cli/emulator_process.h"
#include "cli/recording.h"
#include "cli/report.h"
#include "cli/run_result.h"
#include "cli/terminal.h"
#include "rt-core/epoch.h"

namespace rigor {
namespace {

Result<RigConfig> load(const RunOptions& options) {
  std::vector<ConfigOverride> overrides;
  for (const std::string& text : options.overrides) {
    auto o = ConfigOverride::parse(text);
    if (!o) return tl::unexpected<Error>(o.error());
    overrides.push_back(std::move(*o));
  }
  auto rig = load_rig(options.rig, overrides);
  if (!rig) return rig;
  if (options.clock == "wall") rig->clock = ClockKind::wall;
  if (options.clock == "virtual") rig->clock = ClockKind::virtual_time;
  if (options.duration_s) rig->duration = seconds_from(*options.duration_s);
  if (!options.record.empty()) rig->record.file = options.record;
  if (!options.report.empty()) rig->report = options.report;
  if (rig->clock == ClockKind::virtual_time && rig->duration.ns() == 0)
    return fail(ErrorCode::bad_input, options.rig.string(),
                "expected `duration_s` for a run in virtual time, which would otherwise never end; or give "
                "--duration");
  return rig;
}

std::string status_line(const BenchRun& run, const RunParts& parts, double t_s) {
  const LoopCounters& n = run.counters();
  std::string line = fmt::format("{:6.1f} s  {} cycles, {} skipped, {} misses", t_s, n.run.load(),
                                 n.skipped.load(), n.misses.load());
  for (const auto& c : parts.channels) {
    const Health& h = c->source->health();
    line += fmt::format("  {} {}{}", c->entry->name, h.received.load(), h.connected.load() ? "" : " LOST");
    if (const auto lost = h.lost.load()) line += fmt::format(" (-{})", lost);
  }
  return line;
}

/// Shows how the run goes, until it is told to end.
class StatusThread {
 public:
  StatusThread(const BenchRun& run, const RunParts& parts, BenchTime t0)
      : thread_([this, &run, &parts, t0] {
          LiveLine line;
          const auto step = std::chrono::milliseconds(line.terminal() ? 200 : 1000);
          while (!end_) {
            line.show(status_line(
                run, parts,
                parts.rig.clock == ClockKind::wall
                    ? std::max(0.0, (bench_now() - t0).seconds())
                    : static_cast<double>(run.counters().cycle.load()) * parts.rig.loop.period.seconds()));
            for (auto slept = step; slept.count() > 0 && !end_; slept -= std::chrono::milliseconds(50))
              std::this_thread::sleep_for(std::chrono::milliseconds(50));
          }
        }) {}
  ~StatusThread() {
    end_ = true;
    thread_.join();
  }

 private:
  std::atomic<bool> end_{false};
  std::thread thread_;
};

std::string iso(RealtimeTime t) {
  const std::time_t s = t.ns() / 1'000'000'000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(s), t.ns() / 1'000'000 % 1000);
}

}  // namespace

int run_command(const RunOptions& options) {
  auto rig = load(options);
  if (!rig) return report_error(rig.error(), options.json);
  const bool virtual_time = rig->clock == ClockKind::virtual_time;
  const Registry registry = make_registry();
  StopSource stop;
  SignalStop signals(stop);

  // All that can be refused is refused before a device or a file is touched.
  auto assembly = assemble(std::move(*rig), registry);
  if (!assembly) return report_error(assembly.error(), options.json);
  RunParts& parts = (*assembly)->parts;
  if (!parts.rig.report.empty())
    if (auto s = prepare_report(parts.rig.report); !s) return report_error(s.error(), options.json);

  std::optional<EmulatorProcess> emulators;
  if (!virtual_time && parts.rig.start_emulators && !options.no_emulators && !parts.rig.emulators.empty()) {
    auto started = EmulatorProcess::start(options.rig, options.overrides, seconds(30));
    if (!started) return report_error(started.error(), options.json);
    emulators = std::move(*started);
  }

  BenchRun run(parts, trace ? &*trace : nullptr);
  if (auto s = run.arm(); !s) return report_error(s.error(), options.json);
  const EpochPair epoch = virtual_time ? kVirtualEpoch : read_epoch();
  const BenchTime t0 = virtual_time ? BenchTime(0) : bench_now() + seconds(1);
  auto recorder =
      open_recording(parts, t0, epoch, (*assembly)->simulation ? (*assembly)->simulation->engine() : "");
  if (!recorder) return report_error(recorder.error(), options.json);

  run.set_recorder(recorder->get());

  Result<RunOutcome> outcome = fail(ErrorCode::internal, "run", "did not run");
  {
    std::optional<StatusThread> status;
    if (!options.json) status.emplace(run, parts, t0);
    outcome = run.run(stop.token(), t0);
  }
  Status stopped = run.stop();
  Status recorded = *recorder ? close_recording(**recorder) : Status{};
  if (!outcome) return report_error(outcome.error(), options.json);

  RunContextText text;
  text.engine = (*assembly)->simulation ? (*assembly)->simulation->engine() : "";
  text.utc = iso(epoch.to_utc(t0));
  text.recording = parts.rig.record.file.string();
  nlohmann::json result = run_result(parts, *outcome, recorder->get(), text);
  if (!parts.rig.report.empty())
    if (auto s = write_report(parts.rig.report, result, parts); !s)
      return report_error(s.error(), options.json);
  if (options.json) {
    fmt::print("{}\n", result.dump());
  } else {
    fmt::print("{}", summary_text(result));
    if (!parts.rig.report.empty()) fmt::print("report    {}\n", (parts.rig.report / "index.html").string());
  }
  if (!recorded) return report_error(recorded.error(), false);
  if (!stopped) return report_error(stopped.error(), false);
  const StopReason reason = outcome->loop.reason;
  return reason == StopReason::overrun || reason == StopReason::failed ? 1 : 0;
}

}  // namespace rigor
