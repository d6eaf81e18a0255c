#include "bench/run/replay_assembly.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "bench/application/application_choice.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/record/replay_sink.h"

namespace rigor {
namespace {

/// A program that a recording names is not run unasked.
Status may_run(const RigConfig& rig, const Registry& registry, const std::filesystem::path& recording) {
  const ConfigNode& application = rig.application_params;
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
  if (rig.plugins.empty() || rig.application.empty() || registry.find_application(rig.application)) return {};
  std::vector<std::string> plugins;
  for (const NamedFile& plugin : rig.plugins) plugins.push_back(plugin.file.string());
  return fail(
      ErrorCode::bad_input, recording.string(),
      fmt::format("the application {} is not one that Rigor comes with, and a replay does not load the "
                  "plugins that a recording names ({}); with --run-program it does",
                  rig.application, fmt::join(plugins, ", ")));
}

Status add_channel(RunParts& parts, const ChannelEntry& entry, const ReplayInput& input) {
  auto channel = std::make_unique<RunChannel>();
  channel->entry = &entry;
  channel->replaced_by = "the recording";
  channel->source = std::make_unique<ReplaySource>(input.recording, entry.name);
  channel->script = input.recording->visibility(entry.name);
  if (!channel->script)
    return fail(ErrorCode::bad_input, input.file.string(),
                fmt::format("expected a recording of channel `{}`, found none; it has the topics {}",
                            entry.name, fmt::join(input.recording->topics(), ", ")));
  ChannelConfig config;
  config.name = entry.name;
  config.kind = entry.kind;
  config.period = entry.period;
  config.latency = entry.latency;
  if (auto s = channel->source->configure(config); !s) return s;
  parts.channels.push_back(std::move(channel));
  return {};
}

Status add_sink(RunParts& parts, const SinkEntry& entry) {
  auto sink = std::make_unique<RunSink>();
  sink->entry = &entry;
  sink->replaced_by = "nothing";
  sink->sink = std::make_unique<ReplaySink>(entry.sink.params);
  ChannelConfig config;
  config.name = entry.name;
  if (auto s = sink->sink->configure(config); !s) return s;
  parts.sinks.push_back(std::move(sink));
  return {};
}

}  // namespace

Result<ReplayInput> open_replay(const std::filesystem::path& file) {
  auto run = read_recorded_run(file);
  if (!run) return tl::unexpected<Error>(run.error());
  auto recording = Recording::open(file.string());
  if (!recording) return tl::unexpected<Error>(recording.error());
  return ReplayInput{file, std::move(*run), std::move(*recording)};
}

Result<RigConfig> recorded_rig(const ReplayInput& input, const std::vector<ConfigOverride>& overrides,
                               const Registry& registry, bool run_program) {
  auto rig = recorded_rig(input.run, input.file, overrides);
  if (!rig) return rig;
  if (!run_program) {
    if (auto s = may_run(*rig, registry, input.file); !s) return tl::unexpected<Error>(s.error());
    rig->plugins.clear();
  }
  rig->record.file.clear();
  rig->report.clear();
  return rig;
}

Result<std::unique_ptr<Assembly>> assemble_replay(RigConfig rig, const Registry& registry,
                                                  const ReplayInput& input) {
  auto assembly = std::make_unique<Assembly>();
  assembly->workers = std::make_unique<WorkerPool>(1);
  RunParts& parts = assembly->parts;
  parts.rig = std::move(rig);
  parts.recording = input.file;
  parts.rig.clock = ClockKind::virtual_time;
  parts.rig.duration = parts.rig.loop.period * static_cast<std::int64_t>(input.cycles());
  auto expectations = Expectations::read(parts.rig);
  if (!expectations) return tl::unexpected<Error>(expectations.error());
  parts.expectations = std::move(*expectations);
  if (parts.expectations) {
    auto events = read_recorded_events(input.file, input.run);
    if (!events) return tl::unexpected<Error>(events.error());
    if (parts.expectations->need_faults())
      if (auto s = faults_are_known(input.file, *events); !s) return tl::unexpected<Error>(s.error());
    parts.recorded_faults = std::move(events->faults);
  }
  auto application = make_application(parts.rig, registry);
  if (!application) return tl::unexpected<Error>(application.error());
  parts.application = std::move(*application);
  for (const ChannelEntry& entry : parts.rig.channels)
    if (auto s = add_channel(parts, entry, input); !s) return tl::unexpected<Error>(s.error());
  for (const SinkEntry& entry : parts.rig.sinks)
    if (auto s = add_sink(parts, entry); !s) return tl::unexpected<Error>(s.error());
  return assembly;
}

}  // namespace rigor
