#include <fmt/format.h>
#include <fmt/ranges.h>

#include "bench/application/application_choice.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/report/report.h"
#include "bench/run/backends.h"
#include "bench/run/recording.h"
#include "cli/commands.h"
#include "cli/execute.h"
#include "cli/open_live.h"
#include "cli/overrides.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/record/replay_sink.h"
#include "sensor-hal/record/replay_source.h"

namespace rigor {
namespace {

/// A recording may come from anybody: a program that it names is not run unasked.
Status may_run(const RigConfig& rig, const ReplayOptions& options) {
  const ConfigNode& application = rig.application_params;
  if (options.run_program || !options.rig.empty()) return {};
  for (const char* key : {"command", "library"}) {
    if (!application.has(key)) continue;
    Error e = application.error(key, "").error();
    if (e.where.starts_with("--set")) return {};
    e.message = fmt::format(
        "the recording names a program of its own as application, which would be run from {}: {}; with "
        "--run-program it is, with --set application=… or a RIG it is replaced",
        application.base_dir().empty() ? "." : application.base_dir().string(), rig.application);
    return tl::unexpected<Error>(std::move(e));
  }
  return {};
}

/// The rig to run: the one that is named, or the one in the recording.
Result<RigConfig> load(const ReplayOptions& options, const RecordedRun& recorded, std::uint64_t cycles) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  Result<RigConfig> rig = [&]() -> Result<RigConfig> {
    if (!options.rig.empty()) return load_rig(options.rig, *overrides);
    return recorded_rig(recorded, options.recording, *overrides);
  }();
  if (!rig) return rig;
  if (auto s = may_run(*rig, options); !s) return tl::unexpected<Error>(s.error());
  rig->clock = ClockKind::virtual_time;
  rig->duration = rig->loop.period * static_cast<std::int64_t>(cycles);
  rig->record.file = options.record;
  rig->report = options.report;
  return rig;
}

}  // namespace

int replay_command(const ReplayOptions& options) {
  const auto fail_on = findings_named(options.fail_on);
  if (!fail_on) return report_error(fail_on.error(), options.json);
  std::optional<ProgressTask> reading(std::in_place, "read the recording");
  auto recorded = read_recorded_run(options.recording);
  if (!recorded) return report_error(recorded.error(), options.json);
  if (recorded->dropped > 0)
    write_stderr(fmt::format(
        "rigor: warning: {}: its recorder had to skip {} samples; what the application saw of them is not "
        "there to be seen again\n",
        options.recording.string(), recorded->dropped));
  auto recording = Recording::open(options.recording.string());
  if (!recording) return report_error(recording.error(), options.json);
  reading.reset();
  auto rig = load(options, *recorded, recorded->cycles > 0 ? recorded->cycles : (*recording)->cycles());
  if (!rig) return report_error(rig.error(), options.json);
  InputFiles inputs;
  inputs.add("the recording that is replayed", options.recording);
  inputs.add_rig(*rig);
  const Existing existing = options.force ? Existing::replace : Existing::keep;
  if (auto s = check_run_outputs(*rig, {{options.junit, "--junit"}}, std::move(inputs), existing, true); !s)
    return report_error(s.error(), options.json);
  auto live = open_live(options.live, *rig);
  if (!live) return report_error(live.error(), options.json);
  StopSource stop;
  SignalStop signals(stop);

  Assembly assembly;
  assembly.workers = std::make_unique<WorkerPool>(1);
  RunParts& parts = assembly.parts;
  parts.rig = std::move(*rig);
  auto expectations = Expectations::read(parts.rig);
  if (!expectations) return report_error(expectations.error(), options.json);
  parts.expectations = std::move(*expectations);
  if (parts.expectations) {
    auto events = read_recorded_events(options.recording, *recorded);
    if (!events) return report_error(events.error(), options.json);
    parts.recorded_faults = std::move(events->faults);
  }
  auto application = make_application(parts.rig, make_registry());
  if (!application) return report_error(application.error(), options.json);
  parts.application = std::move(*application);
  for (const ChannelEntry& entry : parts.rig.channels) {
    auto channel = std::make_unique<RunChannel>();
    channel->entry = &entry;
    channel->replaced_by = "the recording";
    channel->source = std::make_unique<ReplaySource>(*recording, entry.name);
    channel->script = (*recording)->visibility(entry.name);
    if (!channel->script) {
      const Error e{ErrorCode::bad_input, options.recording.string(),
                    fmt::format("expected a recording of channel `{}`, found none; it has the topics {}",
                                entry.name, fmt::join((*recording)->topics(), ", "))};
      return report_error(e, options.json);
    }
    ChannelConfig config;
    config.name = entry.name;
    config.kind = entry.kind;
    config.period = entry.period;
    config.latency = entry.latency;
    if (auto s = channel->source->configure(config); !s) return report_error(s.error(), options.json);
    parts.channels.push_back(std::move(channel));
  }
  for (const SinkEntry& entry : parts.rig.sinks) {
    auto sink = std::make_unique<RunSink>();
    sink->entry = &entry;
    sink->replaced_by = "nothing";
    sink->sink = std::make_unique<ReplaySink>(entry.sink.params);
    ChannelConfig config;
    config.name = entry.name;
    if (auto s = sink->sink->configure(config); !s) return report_error(s.error(), options.json);
    parts.sinks.push_back(std::move(sink));
  }
  if (auto s = prepare_outputs(parts.rig, existing, true); !s) return report_error(s.error(), options.json);
  ExecuteOptions how;
  how.json = options.json;
  how.existing = existing;
  how.fail_on = *fail_on;
  how.junit = options.junit;
  how.live = live->get();
  how.live_stays = !options.live.ends;
  how.pace = options.live.pace_or_default();
  how.t0 = recorded->t0;
  how.epoch = recorded->epoch;
  how.ran = [&](std::uint64_t cycle) { return (*recording)->ran(cycle); };
  how.expected_sha256 = recorded->seen_sha256;
  return execute(assembly, how, stop.token());
}

}  // namespace rigor
