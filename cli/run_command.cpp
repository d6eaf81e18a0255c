#include <optional>

#include "bench/bench.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/live/server.h"
#include "builtin/registry.h"
#include "cli/commands.h"
#include "cli/open_live.h"
#include "cli/overrides.h"
#include "cli/run_report_output.h"

namespace rigor {
namespace {

Result<RigConfig> load(const RunOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  auto rig = load_rig(options.rig, *overrides);
  if (!rig) return rig;
  if (options.clock == "wall") rig->clock = ClockKind::wall;
  if (options.clock == "virtual") rig->clock = ClockKind::virtual_time;
  if (options.workers > 0) rig->simulation.workers = options.workers;
  if (options.duration_s) rig->duration = seconds_from(*options.duration_s);
  if (!options.record.empty()) rig->record.file = options.record;
  if (!options.report.empty()) rig->report = options.report;
  if (rig->clock == ClockKind::virtual_time && rig->duration.ns() == 0)
    return fail(ErrorCode::bad_input, options.rig.string(),
                "expected `duration_s` for a run in virtual time, which would otherwise never end; or give "
                "--duration");
  return rig;
}

}  // namespace

int run_command(const RunOptions& options) {
  const auto fail_on = findings_named(options.fail_on);
  if (!fail_on) return report_error(fail_on.error(), options.json);
  auto rig = load(options);
  if (!rig) return report_error(rig.error(), options.json);
  auto live = open_live(options.live, *rig);
  if (!live) return report_error(live.error(), options.json);
  BenchOptions how;
  how.replace = options.force;
  how.trace = options.trace;
  how.junit = options.junit;
  how.faults_from = options.faults_from;
  how.start_emulators = !options.no_emulators;
  how.control = !options.no_control;
  if (options.digest) how.digest = true;
  if (rig->clock == ClockKind::virtual_time) how.pace = options.live.pace_or_default();
  how.fail_on = *fail_on;
  how.live = live->get();
  how.on_warning = print_warning;
  std::optional<ProgressTask> start(std::in_place, "start");
  auto bench = Bench::create(std::move(*rig), make_registry(), std::move(how));
  if (!bench) return report_error(bench.error(), options.json);
  start.reset();

  // Until a device or a file is touched, a signal ends the process at once.
  StopSource stop;
  SignalStop signals(stop, SignalStop::Suspend::refuse);
  if (auto s = (*bench)->prepare(stop.token()); !s) return report_error(s.error(), options.json);
  const auto report = (*bench)->run(stop.token());
  if (!report) return report_error(report.error(), options.json);
  return print_report(*report, options.json);
}

}  // namespace rigor
