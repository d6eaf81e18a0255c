#include <optional>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/control/fault_control.h"
#include "bench/devices/emulator_process.h"
#include "bench/report/report.h"
#include "bench/run/assembly.h"
#include "bench/run/backends.h"
#include "bench/run/recording.h"
#include "cli/commands.h"
#include "cli/execute.h"
#include "cli/open_live.h"
#include "cli/overrides.h"
#include "sensor-hal/channel/fault_bench.h"

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
  // All that can be refused is refused before a device or a file is touched; until then a signal ends the
  // process at once.
  InputFiles inputs;
  inputs.add_rig(*rig);
  inputs.add("the recording of --faults-from", options.faults_from);
  const Existing existing = options.force ? Existing::replace : Existing::keep;
  if (auto s = check_run_outputs(*rig, {{options.trace, "--trace"}, {options.junit, "--junit"}},
                                 std::move(inputs), existing);
      !s)
    return report_error(s.error(), options.json);
  std::optional<ProgressTask> start(std::in_place, "start");
  auto assembly = assemble(std::move(*rig), make_registry());
  if (!assembly) return report_error(assembly.error(), options.json);
  if (!options.faults_from.empty())
    if (auto s =
            schedule_recorded_faults(options.faults_from, (*assembly)->parts.rig, *(*assembly)->parts.faults);
        !s)
      return report_error(s.error(), options.json);
  const RigConfig& checked = (*assembly)->parts.rig;

  StopSource stop;
  SignalStop signals(stop, SignalStop::Suspend::refuse);
  if (auto s = prepare_outputs(checked, existing); !s) return report_error(s.error(), options.json);
  std::optional<EmulatorProcess> emulators;
  if (checked.clock == ClockKind::wall && checked.start_emulators && !options.no_emulators &&
      !checked.emulators.empty()) {
    const ProgressTask coming("bring up the emulators");
    auto started = EmulatorProcess::start(options.rig, options.overrides, seconds(300), stop.token());
    if (!started) return report_error(started.error(), options.json);
    emulators.emplace(std::move(*started));
    (*assembly)->parts.emulators = &*emulators;
  }
  start.reset();
  ExecuteOptions how;
  how.json = options.json;
  how.existing = existing;
  how.fail_on = *fail_on;
  how.trace = options.trace;
  how.junit = options.junit;
  how.control = !options.no_control;
  how.live = live->get();
  if (checked.clock == ClockKind::virtual_time) how.pace = options.live.pace_or_default();
  return execute(**assembly, how, stop.token());
}

}  // namespace rigor
