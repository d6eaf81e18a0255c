#include "calibration/procedures/recorded_stamps.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <set>

#include "bench/console/progress.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {
namespace {

using record::McapReader;
using record::MessageView;

constexpr std::string_view kCommands = "/rigor/commands", kEvents = "/rigor/events";

/// What the file says of its run; empty texts where it does not.
struct RunOfFile {
  std::string clock, rig_file, rig_text;
  std::int64_t to_utc_ns = 0;
};

RunOfFile run_of(McapReader& reader) {
  RunOfFile run;
  for (const record::Metadata& m : reader.readable_metadata()) {
    const auto text = [&](const char* key) {
      const auto at = m.values.find(key);
      return at == m.values.end() ? std::string() : at->second;
    };
    if (m.name != "rigor") continue;
    run.clock = text("clock"), run.rig_file = text("rig_file"), run.rig_text = text("rig");
    const std::string ns = text("utc_of_bench_0_ns");
    (void)std::from_chars(ns.data(), ns.data() + ns.size(), run.to_utc_ns);
  }
  return run;
}

/// Channels of the rig, and sides of pairs, that a simulator measures. A rig that cannot be read names none.
std::set<std::string> simulated_channels(const std::string& rig_text) {
  std::set<std::string> names;
  const auto root = ConfigDocument::parse(rig_text, "rig");
  if (!root) return names;
  (void)catch_config([&] {
    const ConfigNode channels = root->map_or_absent("channels");
    for (const std::string& name : channels.keys()) {
      const ConfigNode channel = channels.map(name);
      if (channel.scalar_or_empty("backend") == "simulated") names.insert(name);
      const ConfigNode pair = channel.map_or_absent("pair");
      for (const char* side : {"real", "simulated"})
        if (pair.map_or_absent(side).scalar_or_empty("backend") == "simulated")
          names.insert(name + "/" + side);
    }
    return 0;
  });
  return names;
}

/// Hands each message of a reader's topics over; false from `take`: enough.
Status each_message(McapReader& reader, std::set<std::string> topics, const std::string& task,
                    const std::function<Result<bool>(const MessageView&)>& take,
                    std::vector<std::string>& warnings) {
  for (const auto& note : reader.health().notes) warnings.push_back(reader.name() + ": " + note);
  ProgressTask progress(task, 0, "messages");
  std::uint64_t taken = 0;
  auto cursor = reader.messages({.topics = std::move(topics), .order = record::MessageOrder::file});
  MessageView view;
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    const auto on = take(view);
    if (!on) return tl::unexpected<Error>(on.error());
    if (!*on) return {};
    progress.set(static_cast<double>(++taken));
  }
  if (cursor.skipped_segments() > 0)
    warnings.push_back(reader.name() + ": " + std::to_string(cursor.skipped_segments()) +
                       " damaged chunks were passed over");
  progress.finish();
  return {};
}

}  // namespace

const RecordedStamps* StampedRecording::find(const std::string& channel) const {
  const auto at = std::find_if(channels.begin(), channels.end(),
                               [&](const RecordedStamps& c) { return c.channel == channel; });
  return at == channels.end() ? nullptr : &*at;
}

std::vector<std::string> StampedRecording::names() const {
  std::vector<std::string> names;
  for (const RecordedStamps& c : channels) names.push_back(c.channel);
  return names;
}

Result<StampedRecording> read_stamps(const std::filesystem::path& file, const StopToken& stop) {
  auto reader = McapReader::open(file.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  const RunOfFile run = run_of(**reader);
  if (run.clock == "virtual")
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected a recording of devices in wall-clock time, got a run in virtual time, in which every "
        "sample arrives at its release, which latency_ms itself sets: record with `rigor run --clock "
        "wall`");
  std::set<std::string> topics;
  for (const auto& [id, c] : (*reader)->channels()) {
    const auto schema = (*reader)->schemas().find(c.schema);
    if (schema != (*reader)->schemas().end() && schema->second.name == record::msg::SampleStamp::kType)
      topics.insert(c.topic);
  }
  if (topics.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected a recording of `rigor run`, whose samples have stamps (topics …/stamp of "
                "rigor_msgs/SampleStamp) with capture and arrival; this file has none");
  for (const std::string_view more : {kCommands, kEvents}) topics.emplace(more);

  StampedRecording out;
  out.file = file, out.rig_file = run.rig_file;
  std::map<std::string, RecordedStamps> found;
  std::map<std::string, std::uint64_t> faults;
  const auto take = [&](const MessageView& view) -> Result<bool> {
    if (view.channel->topic == kCommands) {
      record::msg::Command m;
      if (auto s = record::CdrReader::read(view.data, m); !s) return tl::unexpected<Error>(s.error());
      out.sinks.try_emplace(m.channel, m.names);
    } else if (view.channel->topic == kEvents) {
      record::msg::Event m;
      if (auto s = record::CdrReader::read(view.data, m); !s) return tl::unexpected<Error>(s.error());
      if (m.kind == "fault_begin") ++faults[m.channel];
    } else {
      record::msg::SampleStamp m;
      if (auto s = record::CdrReader::read(view.data, m); !s) return tl::unexpected<Error>(s.error());
      found[m.channel].stamps.push_back(
          {m.t_capture_ns, m.t_arrival_ns, m.t_release_ns, m.sigma_capture_ns, m.validity});
    }
    return !stop.stop_requested();
  };
  if (auto s =
          each_message(**reader, std::move(topics), "read " + file.filename().string(), take, out.warnings);
      !s)
    return tl::unexpected<Error>(s.error());

  const auto simulated = simulated_channels(run.rig_text);
  for (auto& [name, stamps] : found) {
    stamps.channel = name;
    stamps.simulated = simulated.contains(name);
    if (const auto n = faults.find(stamps.rig_channel()); n != faults.end()) stamps.faults = n->second;
    std::stable_sort(stamps.stamps.begin(), stamps.stamps.end(),
                     [](const auto& a, const auto& b) { return a.capture_ns < b.capture_ns; });
    out.channels.push_back(std::move(stamps));
  }
  return out;
}

Result<std::vector<RecordedCommand>> read_commands(const std::filesystem::path& file, const std::string& sink,
                                                   const std::string& value, const StopToken& stop) {
  auto reader = McapReader::open(file.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  const std::int64_t to_utc_ns = run_of(**reader).to_utc_ns;
  std::vector<RecordedCommand> commands;
  std::set<std::string> sinks, names;
  std::vector<std::string> warnings;
  const auto take = [&](const MessageView& view) -> Result<bool> {
    record::msg::Command m;
    if (auto s = record::CdrReader::read(view.data, m); !s) return tl::unexpected<Error>(s.error());
    sinks.insert(m.channel);
    if (m.channel != sink) return true;
    for (std::size_t i = 0; i < std::min(m.names.size(), m.values.size()); ++i) {
      names.insert(m.names[i]);
      if (m.names[i] != value || !std::isfinite(m.values[i])) continue;
      const std::int64_t utc_ns = std::int64_t{m.header.stamp.sec} * 1'000'000'000 + m.header.stamp.nanosec;
      commands.push_back({utc_ns - to_utc_ns, m.t_effect_ns, m.values[i]});
    }
    return !stop.stop_requested();
  };
  if (auto s = each_message(**reader, {std::string(kCommands)}, "read " + sink, take, warnings); !s)
    return tl::unexpected<Error>(s.error());
  const auto list = [](const std::set<std::string>& of) {
    return std::vector<std::string>(of.begin(), of.end());
  };
  if (!sinks.contains(sink))
    return fail(ErrorCode::bad_input, file.string(),
                "expected commands to a sink " + sink + " for " + sink + ":" + value +
                    ", found none; sinks with commands: " + joined_or_none(list(sinks)) +
                    did_you_mean(sink, list(sinks)));
  if (!names.contains(value))
    return fail(ErrorCode::bad_input, file.string(),
                "expected a value " + value + " of the sink " + sink + ", found none of that name; values: " +
                    joined_or_none(list(names)) + did_you_mean(value, list(names)));
  if (commands.empty())
    return fail(ErrorCode::bad_input, file.string(), "expected finite values of " + sink + ":" + value);
  std::stable_sort(commands.begin(), commands.end(),
                   [](const auto& a, const auto& b) { return a.effect_ns < b.effect_ns; });
  return commands;
}

}  // namespace rigor
