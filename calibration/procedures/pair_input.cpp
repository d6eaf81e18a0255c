#include "calibration/procedures/pair_input.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <map>

#include "bench/run/recording.h"
#include "bench/sensing/mount.h"
#include "sensor-hal/record/sample_codec.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

constexpr std::size_t kWaiting = 64;

bool has_model(SampleKind k) {
  return k == SampleKind::image || k == SampleKind::range_image || k == SampleKind::point_cloud ||
         k == SampleKind::register_block || k == SampleKind::imu;
}

/// The map without the flag, so that the pose is read as it stands, terrain or not.
Result<Eigen::Isometry3d> pose_of(const ConfigNode& params, const std::string& key, SensorAxes axes,
                                  bool& above_ground) {
  return catch_config([&] {
    const ConfigNode n = params.map(key);
    above_ground = n.flag_or("above_ground", false);
    return read_pose(n, axes, [](double, double) { return 0.0; });
  });
}

}  // namespace

Result<RecordedPair> find_recorded_pair(const std::filesystem::path& recording,
                                        const std::filesystem::path& rig_file, const std::string& channel) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(recording, ec))
    return fail(ErrorCode::not_found, recording.string(), "expected a recording (.mcap), got no such file");
  const auto rig = [&]() -> Result<RigConfig> {
    if (!rig_file.empty()) return load_rig(rig_file, {});
    auto run = read_recorded_run(recording);
    if (!run) return tl::unexpected<Error>(run.error());
    auto root = ConfigDocument::parse(
        run->rig_text, fmt::format("{} (as recorded in {})", run->rig_file, recording.filename().string()));
    if (!root) return tl::unexpected<Error>(root.error());
    return parse_rig(*root, run->rig_file);
  }();
  if (!rig) return tl::unexpected<Error>(rig.error());
  std::vector<std::string> pairs, others;
  const ChannelEntry* entry = nullptr;
  for (const ChannelEntry& c : rig->channels) {
    (c.is_pair ? pairs : others).push_back(c.name);
    if (c.name == channel || (channel.empty() && c.is_pair && !entry)) entry = &c;
  }
  const std::string where = recording.string();
  if (pairs.empty())
    return fail(
        ErrorCode::bad_input, where,
        fmt::format("expected a recording of a rig with a pair channel (`pair: {{ real, simulated }}`), "
                    "its rig has none; channels: {}",
                    fmt::join(others, ", ")));
  if (channel.empty() && pairs.size() > 1)
    return fail(ErrorCode::bad_input, where,
                fmt::format("has several pairs: say which one with --channel: {}", fmt::join(pairs, ", ")));
  if (!entry)
    return fail(ErrorCode::bad_input, where,
                fmt::format("expected a channel {}, found none of that name; pairs: {}", channel,
                            fmt::join(pairs, ", ")));
  if (!entry->is_pair)
    return fail(
        ErrorCode::bad_input, where,
        fmt::format("expected a pair, channel {} is none; pairs: {}", channel, fmt::join(pairs, ", ")));
  RecordedPair out;
  out.recording = recording, out.channel = entry->name, out.kind = entry->kind;
  out.rig_file = rig->file.string();
  out.entry = *entry;
  if (const auto run = read_recorded_run(recording)) out.t0 = run->t0, out.t0_known = true;
  if (!has_model(entry->kind))
    return fail(
        ErrorCode::bad_input, where,
        fmt::format("expected a pair of cameras, LiDARs, time-of-flight cameras, registers or inertial "
                    "units, channel {} is of kind {}",
                    entry->name, kind_name(entry->kind)));
  const ConfigNode& params = entry->simulated.params;
  if (params.has("sensor")) out.sensor_model_file = params.base_dir() / params.text("sensor");
  if (const auto draw = params.has("calibration_draw") ? params.text("calibration_draw") : "0"; draw != "0")
    return fail(ErrorCode::bad_input, params.place(),
                "expected a simulated side of the sensor model itself, got calibration_draw: " + draw +
                    "; the proposal changes the sensor model, not one device drawn from it");
  for (const char* key : {"T_world_sensor", "T_parent_sensor"}) {
    if (!params.has(key)) continue;
    const auto axes = entry->kind == SampleKind::image || entry->kind == SampleKind::range_image
                          ? SensorAxes::optical
                          : SensorAxes::forward;
    const auto pose = pose_of(params, key, axes, out.above_ground);
    if (!pose) return tl::unexpected<Error>(pose.error());
    out.mount_key = key, out.T_parent_sensor = *pose;
  }
  return out;
}

Status read_pairs(const RecordedPair& pair, const calibration::TakePair& take, std::uint64_t& alone) {
  auto reader = record::McapReader::open(pair.recording.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  struct Side {
    std::string name;
    record::SampleDecoder decoder;
    std::map<std::int64_t, Sample> waiting;
    bool any = false;
  };
  const std::string kind(record::topic_of(pair.kind));
  const auto side = [&](const char* name) {
    return Side{name, record::SampleDecoder("/" + pair.channel + "/" + name + "/" + kind), {}, false};
  };
  std::array<Side, 2> sides{side("real"), side("simulated")};
  record::MessageFilter filter{.order = record::MessageOrder::file};
  for (const auto& [id, c] : (*reader)->channels())
    for (const Side& s : sides)
      if (s.decoder.wants(c.topic)) filter.topics.insert(c.topic);
  std::vector<Sample> spare;
  auto cursor = (*reader)->messages(filter);
  record::MessageView view;
  alone = 0;
  BenchTime t0 = pair.t0;
  bool t0_known = pair.t0_known, any_in_span = false;
  while (!filter.topics.empty()) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    for (std::size_t k = 0; k < 2; ++k) {
      Side &s = sides[k], &other = sides[1 - k];
      const auto whole = s.decoder.take(view);
      if (!whole) return tl::unexpected<Error>(whole.error());
      if (!*whole) continue;
      Sample sample;
      if (!spare.empty()) sample = std::move(spare.back()), spare.pop_back();
      if (sample.memory().size() < s.decoder.size_bytes()) sample.reserve(s.decoder.size_bytes());
      if (auto filled = s.decoder.fill(sample); !filled) return filled;
      if (sample.kind() != pair.kind) continue;
      s.any = true;
      if (!t0_known) t0 = sample.stamp.t_capture, t0_known = true;
      const double t_s = (sample.stamp.t_capture - t0).seconds();
      if (t_s < pair.from_s || t_s >= pair.until_s) {
        spare.push_back(std::move(sample));
        continue;
      }
      any_in_span = true;
      const std::int64_t t = sample.stamp.t_capture.ns();
      if (const auto partner = other.waiting.find(t); partner != other.waiting.end()) {
        take(k == 0 ? sample : partner->second, k == 0 ? partner->second : sample);
        spare.push_back(std::move(partner->second));
        other.waiting.erase(partner);
        spare.push_back(std::move(sample));
        continue;
      }
      s.waiting.insert_or_assign(t, std::move(sample));
      if (s.waiting.size() > kWaiting) {
        spare.push_back(std::move(s.waiting.begin()->second));
        s.waiting.erase(s.waiting.begin());
        ++alone;
      }
    }
  }
  if (!any_in_span && sides[0].any && sides[1].any)
    return fail(ErrorCode::bad_input, pair.recording.string(),
                "expected samples between --from and --until, found none");
  for (const Side& s : sides) {
    alone += s.waiting.size();
    if (!s.any)
      return fail(
          ErrorCode::bad_input, pair.recording.string(),
          fmt::format("expected samples of {}/{}, found none; a recording by `rigor run` of a pair has "
                      "both sides",
                      pair.channel, s.name));
  }
  return {};
}

}  // namespace rigor
