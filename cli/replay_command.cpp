#include <fmt/format.h>

#include "bench/bench.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/live/server.h"
#include "bench/run/replay_assembly.h"
#include "builtin/registry.h"
#include "cli/commands.h"
#include "cli/open_live.h"
#include "cli/overrides.h"
#include "cli/run_report_output.h"

namespace rigor {
namespace {

/// The rig to run: the one that is named, or the one in the recording.
Result<RigConfig> load(const ReplayOptions& options, const Registry& registry, const ReplayInput& input) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  auto rig = options.rig.empty() ? recorded_rig(input, *overrides, registry, options.run_program)
                                 : load_rig(options.rig, *overrides);
  if (!rig) return rig;
  rig->clock = ClockKind::virtual_time;
  rig->record.file = options.record;
  rig->report = options.report;
  return rig;
}

}  // namespace

int replay_command(const ReplayOptions& options) {
  const auto fail_on = findings_named(options.fail_on);
  if (!fail_on) return report_error(fail_on.error(), options.json);
  std::optional<ProgressTask> reading(std::in_place, "read the recording");
  auto input = open_replay(options.recording);
  if (!input) return report_error(input.error(), options.json);
  if (input->run.dropped > 0)
    print_warning(
        fmt::format("{}: its recorder had to skip {} samples; what the application saw of them is not there "
                    "to be seen again",
                    options.recording.string(), input->run.dropped));
  reading.reset();
  const Registry registry = make_registry();
  auto rig = load(options, registry, *input);
  if (!rig) return report_error(rig.error(), options.json);
  auto live = open_live(options.live, *rig);
  if (!live) return report_error(live.error(), options.json);
  BenchOptions how;
  how.replace = options.force;
  how.junit = options.junit;
  how.pace = options.live.pace_or_default();
  how.fail_on = *fail_on;
  how.live = live->get();
  how.live_stays = !options.live.ends;
  how.on_warning = print_warning;
  auto bench = Bench::create_replay(std::move(*rig), registry, std::move(*input), std::move(how));
  if (!bench) return report_error(bench.error(), options.json);
  StopSource stop;
  SignalStop signals(stop);
  if (auto s = (*bench)->prepare(stop.token()); !s) return report_error(s.error(), options.json);
  const auto report = (*bench)->run(stop.token());
  if (!report) return report_error(report.error(), options.json);
  const int status = print_report(*report, options.json);
  if (*live && !options.live.ends && report->outcome.loop.reason == StopReason::finished)
    wait_for_live_end(**live, stop.token());
  return status;
}

}  // namespace rigor
