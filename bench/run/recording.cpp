#include "bench/run/recording.h"

#include <algorithm>
#include <charconv>

#include "bench/sensing/camera_info.h"
#include "bench/sensing/scan_line.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/slot_wait.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recording_schema.h"

namespace rigor {
namespace {

std::optional<std::int64_t> number(const std::map<std::string, std::string>& m, const std::string& key) {
  const auto it = m.find(key);
  if (it == m.end()) return std::nullopt;
  std::int64_t v = 0;
  const auto [end, ec] = std::from_chars(it->second.data(), it->second.data() + it->second.size(), v);
  if (ec != std::errc{} || end != it->second.data() + it->second.size()) return std::nullopt;
  return v;
}

std::optional<CameraModel> camera_of(const ChannelEntry& entry) {
  const ConfigNode& params = entry.is_pair ? entry.simulated.params : entry.source.params;
  if (entry.kind != SampleKind::image || !params.has("sensor")) return std::nullopt;
  const auto sensor_model = load_camera(params.base_dir() / params.text("sensor"));
  if (!sensor_model) return std::nullopt;  // the assembly has refused it before
  return sensor_model->model;
}

const RunChannel* channel_named(const RunParts& parts, const std::string& name) {
  for (const auto& c : parts.channels)
    if (c->entry->name == name) return c.get();
  return nullptr;
}

}  // namespace

std::optional<record::msg::CameraInfo> camera_info(const RunParts& parts, const ChannelEntry& entry) {
  const auto camera = camera_of(entry);
  if (!camera) return std::nullopt;
  for (const FramesConfig::Stereo& pair : parts.rig.frames.stereo) {
    if (entry.name != pair.left && entry.name != pair.right) continue;
    const RunChannel *left = channel_named(parts, pair.left), *right = channel_named(parts, pair.right);
    if (!left || !right || !parts.frames) continue;
    const auto T_left_right =
        parts.frames->T_fixed(left->source->describe().frame_id, right->source->describe().frame_id);
    const auto left_camera = camera_of(*left->entry), right_camera = camera_of(*right->entry);
    if (!T_left_right || !left_camera || !right_camera) continue;
    const auto both = stereo_camera_info(*left_camera, *right_camera, *T_left_right);
    if (both) return entry.name == pair.left ? both->left : both->right;
  }
  return camera_info(*camera);
}

Result<std::vector<RecordedChannel>> recorded_channels(const RunParts& parts) {
  std::vector<RecordedChannel> channels;
  for (const auto& c : parts.channels) {
    RecordedChannel channel;
    channel.name = c->entry->name;
    channel.description = c->source->describe();
    channel.is_pair = c->pair != nullptr;
    channel.camera = camera_info(parts, *c->entry);
    channel.points = c->entry->points;
    const auto lines = scan_lines(parts.rig, *c->entry);
    if (!lines) return tl::unexpected<Error>(lines.error());
    channel.scan = lines->own;
    channel.simulated_scan = lines->simulated;
    if (c->pair && c->pair->monitor()) channel.watched = c->pair->monitor()->parameters();
    channels.push_back(std::move(channel));
  }
  return channels;
}

Result<std::unique_ptr<record::FrameSource>> frame_source(const RunParts& parts, const EpochPair& epoch) {
  if (!parts.rig.frames.publish) return std::unique_ptr<record::FrameSource>();
  if (!parts.recording.empty())
    return record::recorded_frames(parts.recording.string(), epoch.utc - RealtimeTime(epoch.bench.ns()));
  return parts.frames ? record::source_of(parts.frames) : nullptr;
}

std::map<std::string, std::string> run_metadata(const RunParts& parts, const EpochPair& epoch) {
  const RigConfig& rig = parts.rig;
  std::map<std::string, std::string> m;
  m[record::kRecordingSchemaKey] = std::to_string(record::kRecordingSchema);
  m["rig"] = rig.text;
  m["rig_file"] = rig.file.string();
  m["seed"] = std::to_string(rig.seed);
  m["clock"] = rig.clock == ClockKind::wall ? "wall" : "virtual";
  m["epoch_bench_ns"] = std::to_string(epoch.bench.ns());
  m["epoch_utc_ns"] = std::to_string(epoch.utc.ns());
  m["epoch_sigma_ns"] = std::to_string(epoch.sigma.ns());
  m["version"] = RIGOR_VERSION;
  for (const auto& c : parts.channels)
    if (!c->replaced_by.empty()) m["replaced/" + c->entry->name] = c->replaced_by;
  std::string assumed;
  for (const std::string& frame : parts.frames_assumed) assumed += (assumed.empty() ? "" : " ") + frame;
  if (!assumed.empty()) m["frames_assumed"] = assumed;
  return m;
}

namespace {

/// Of the 16 slots that a channel has, or of those that its keys ask for: the others are the loop's. A
/// recorder that a busy machine lets wait longer than these last has to skip samples.
std::size_t lease_budget(const ChannelEntry& entry, std::size_t bridges) {
  constexpr std::int64_t kUsual = 16, kForTheLoop = kSlotsForTheLoop;
  const auto slots_of = [](const ConfigNode& n) {
    return n.integer_or(n.has("buffers") ? "buffers" : "slots", kUsual, {.min = 1, .max = 65536});
  };
  std::int64_t slots = slots_of(entry.source.params);
  if (entry.is_pair) slots = std::min(slots, slots_of(entry.simulated.params));
  // A bridge and what it sends through hold up to four.
  const auto for_bridges = static_cast<std::int64_t>(4 * bridges);
  return static_cast<std::size_t>(
      std::max<std::int64_t>(std::max(slots, kUsual) - kForTheLoop - for_bridges, 2));
}

}  // namespace

Result<std::unique_ptr<Recorder>> open_recording(RunParts& parts, const RecordingFile& file,
                                                 const EpochPair& epoch,
                                                 std::map<std::string, std::string> metadata) {
  const RigConfig& rig = parts.rig;
  RecorderOptions options;
  options.virtual_time = rig.clock == ClockKind::virtual_time;
  options.fail_on_drop = rig.record.fail_on_drop;
  options.budget_bytes = rig.record.budget_bytes;
  options.epoch = epoch;
  // A power cut loses what the kernel had not written; once a second it is made to, on a thread of its own.
  if (!options.virtual_time) options.file.sync_period = seconds(1);
  options.loop_period = rig.loop.period;
  options.writer.compression = rig.record.compression == "zstd"  ? record::Compression::zstd
                               : rig.record.compression == "lz4" ? record::Compression::lz4
                                                                 : record::Compression::none;
  options.writer.chunk_bytes = rig.record.chunk_bytes;
  auto channels = recorded_channels(parts);
  if (!channels) return tl::unexpected<Error>(channels.error());
  for (std::size_t i = 0; i < channels->size(); ++i) {
    parts.channels[i]->recorder_id = static_cast<std::uint32_t>(i);
    (*channels)[i].lease_budget = lease_budget(*parts.channels[i]->entry, parts.bridges.size());
  }
  auto frames = frame_source(parts, epoch);
  if (!frames) return tl::unexpected<Error>(frames.error());
  options.frames = std::move(*frames);
  options.frames_period = rig.frames.period;
  options.root_frame = rig.frames.root;
  options.clock = options.virtual_time && rig.frames.publish;
  std::vector<RecordedSink> sinks;
  for (auto& s : parts.sinks) sinks.push_back({s->entry->name, s->sink->describe().names});
  metadata.merge(run_metadata(parts, epoch));
  auto sink = file.sink(options.file);
  if (!sink) return tl::unexpected<Error>(sink.error());
  auto recorder = Recorder::create(std::move(*sink), options, std::move(*channels), std::move(sinks),
                                   std::move(metadata));
  if (!recorder) return recorder;
  for (auto& c : parts.channels)
    if (c->pair) c->pair->observe((*recorder)->observer(c->recorder_id));
  return recorder;
}

namespace {

/// What sources and emulators write, by their backends' own account.
Result<std::vector<std::filesystem::path>> files_of_devices(const RigConfig& rig, const Registry& registry) {
  return catch_config([&] {
    std::vector<std::filesystem::path> files;
    const auto look = [&](const BackendChoice& choice) {
      const Backend* backend = registry.find(choice.backend);
      if (!backend || !backend->files) return;
      for (auto& file : backend->files(choice.params)) files.push_back(std::move(file));
    };
    for (const ChannelEntry& c : rig.channels) look(c.source);
    for (const EmulatorEntry& e : rig.emulators) look(e.emulator);
    return files;
  });
}

/// What the application writes, by its own account.
Result<std::vector<std::filesystem::path>> files_of_application(const RigConfig& rig,
                                                                const Registry& registry) {
  const NamedApplication* known = registry.find_application(rig.application);
  if (!known || !known->files) return std::vector<std::filesystem::path>{};
  return catch_config([&] { return known->files(rig.application_params); });
}

}  // namespace

Status prepare_outputs(const RigConfig& rig, const Registry& registry, Existing existing, bool replay) {
  const auto files = files_of_application(rig, registry);
  if (!files) return tl::unexpected<Error>(files.error());
  if (existing != Existing::replace) {
    std::map<std::filesystem::path, std::vector<std::string>> by_folder;
    for (const auto& file : *files) {
      std::error_code ec;
      if (std::filesystem::exists(file, ec))
        by_folder[file.parent_path()].push_back(file.filename().string());
    }
    for (const auto& [dir, names] : by_folder)
      if (auto s = keep_earlier_files(dir, names); !s) return s;
  }
  if (replay) return {};
  const auto logs = files_of_devices(rig, registry);
  if (!logs) return tl::unexpected<Error>(logs.error());
  for (const auto& log : *logs) {
    std::error_code ec;
    if (log.has_parent_path()) std::filesystem::create_directories(log.parent_path(), ec);
    if (ec) return tl::unexpected<Error>(output_error(log, ec.value()));
    if (existing == Existing::replace) continue;
    if (const auto kept = keep_earlier(log); !kept) return tl::unexpected<Error>(kept.error());
  }
  return {};
}

Status check_run_outputs(const RigConfig& rig, const Registry& registry, const std::vector<NamedOutput>& more,
                         InputFiles inputs, Existing existing, bool replay) {
  Outputs outputs(std::move(inputs));
  if (!rig.record.file.empty())
    if (auto s = outputs.add(rig.record.file, "--record", existing); !s) return s;
  for (const NamedOutput& o : more)
    if (!o.file.empty())
      if (auto s = outputs.add(o.file, o.option, existing); !s) return s;
  const auto files = files_of_application(rig, registry);
  if (!files) return tl::unexpected<Error>(files.error());
  if (!files->empty())
    if (auto s = outputs.add(files->front(), "`output` of the application", existing); !s) return s;
  if (!replay) {
    const auto logs = files_of_devices(rig, registry);
    if (!logs) return tl::unexpected<Error>(logs.error());
    for (const auto& log : *logs)
      if (auto s = outputs.add(log, "`log`", existing); !s) return s;
  }
  return rig.report.empty() ? Status{} : outputs.add_report(rig.report);
}

Result<RecordedRun> read_recorded_run(const std::filesystem::path& file) {
  auto reader = record::McapReader::open(file.string());
  if (!reader) return tl::unexpected<Error>(reader.error());
  RecordedRun run;
  bool found = false;
  for (const record::Metadata& m : (*reader)->readable_metadata()) {
    if (m.values.contains(record::kRecordingSchemaKey)) {
      const auto t0 = number(m.values, "t0_ns"), bench = number(m.values, "epoch_bench_ns"),
                 utc = number(m.values, "epoch_utc_ns"), sigma = number(m.values, "epoch_sigma_ns");
      if (!t0 || !bench || !utc || !sigma || !m.values.contains("rig")) break;
      run.t0 = BenchTime(*t0);
      run.epoch = {BenchTime(*bench), RealtimeTime(*utc), Duration(*sigma)};
      run.rig_text = m.values.at("rig");
      run.rig_file = m.values.contains("rig_file") ? m.values.at("rig_file") : file.string();
      found = true;
    }
    if (m.name == "rigor_recorder") {
      run.cycles =
          static_cast<std::uint64_t>(std::max<std::int64_t>(0, number(m.values, "cycles").value_or(0)));
      run.dropped =
          static_cast<std::uint64_t>(std::max<std::int64_t>(0, number(m.values, "dropped").value_or(0)));
      if (m.values.contains(kInputDigestKey)) run.input_sha256 = m.values.at(kInputDigestKey);
    }
  }
  if (!found)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a recording of `rigor run`, which carries its rig; this file has none");
  return run;
}

Result<RigConfig> recorded_rig(const RecordedRun& run, const std::filesystem::path& recording,
                               const std::vector<ConfigOverride>& overrides) {
  auto root = ConfigDocument::parse(
      run.rig_text, run.rig_file + " (as recorded in " + recording.filename().string() + ")", overrides);
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_rig(*root, run.rig_file);
}

}  // namespace rigor
