#include "calibration/procedures/recording_input.h"

#include <algorithm>
#include <map>
#include <set>

#include "calibration/procedures/recording_packets.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

struct KindOfTopic {
  SampleKind kind;
  std::string_view suffix;  ///< of the topics of a rig's channels
  std::string_view type;    ///< of the main message
};
constexpr KindOfTopic kKindsOfTopics[] = {
    {SampleKind::image, "image", "sensor_msgs/msg/Image"},
    {SampleKind::range_image, "range", "sensor_msgs/msg/Image"},
    {SampleKind::point_cloud, "points", "sensor_msgs/msg/PointCloud2"},
    {SampleKind::register_block, "registers", "rigor_msgs/msg/RegisterBlock"},
    {SampleKind::pose, "pose", "geometry_msgs/msg/PoseStamped"},
    {SampleKind::event, "events", "rigor_msgs/msg/Event"}};

const KindOfTopic* kind_of(SampleKind kind) {
  const auto* it = std::find_if(std::begin(kKindsOfTopics), std::end(kKindsOfTopics),
                                [&](const auto& k) { return k.kind == kind; });
  return it == std::end(kKindsOfTopics) ? nullptr : it;
}

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const auto& n : names) text += (text.empty() ? "" : ", ") + n;
  return text.empty() ? "none" : text;
}

/// What a topic is called for a user: a rig's channel by its name, anything else by the topic.
std::string channel_of(const std::string& topic, const KindOfTopic& kind) {
  const std::string end = "/" + std::string(kind.suffix);
  if (topic.size() > end.size() + 1 && topic.starts_with('/') && topic.ends_with(end))
    return topic.substr(1, topic.size() - 1 - end.size());
  return topic;
}

/// Topics of the kind's type. Range images and pictures are of one type: the name tells them apart where a
/// rig wrote them.
std::vector<std::string> topics_of(const record::McapReader& reader, const KindOfTopic& kind) {
  std::set<std::string> topics;
  for (const auto& [id, channel] : reader.channels()) {
    const auto schema = reader.schemas().find(channel.schema);
    if (schema == reader.schemas().end() || schema->second.name != kind.type) continue;
    const bool amplitude = channel.topic.ends_with("/range/amplitude");
    const bool range = channel.topic.ends_with("/range"), image = channel.topic.ends_with("/image");
    if (amplitude || (kind.kind == SampleKind::image && range) ||
        (kind.kind == SampleKind::range_image && image))
      continue;
    topics.insert(channel.topic);
  }
  return {topics.begin(), topics.end()};
}

std::string all_topics(const record::McapReader& reader) {
  std::set<std::string> all;
  for (const auto& [id, c] : reader.channels()) all.insert(c.topic);
  return joined({all.begin(), all.end()});
}

Result<std::string> choose_topic(const record::McapReader& reader, const std::string& file,
                                 const std::string& channel, const KindOfTopic& kind) {
  const auto topics = topics_of(reader, kind);
  std::vector<std::string> names;
  for (const auto& t : topics) names.push_back(channel_of(t, kind));
  if (channel.empty()) {
    if (topics.size() == 1) return topics.front();
    if (topics.empty())
      return fail(ErrorCode::bad_input, file,
                  "expected a channel of messages " + std::string(kind.type) + " (…/" +
                      std::string(kind.suffix) +
                      "), found none; topics that there are: " + all_topics(reader));
    return fail(ErrorCode::bad_input, file,
                "has several channels of this kind: say which one with --channel: " + joined(names));
  }
  for (std::size_t i = 0; i < topics.size(); ++i)
    if (topics[i] == channel || names[i] == channel) return topics[i];
  return fail(ErrorCode::bad_input, file,
              "expected a channel " + channel + " of messages " + std::string(kind.type) + " (…/" +
                  std::string(kind.suffix) + "), found none of that name; " +
                  (names.empty() ? "topics that there are: " + all_topics(reader)
                                 : "those of this kind: " + joined(names)));
}

}  // namespace

bool is_recording(const std::filesystem::path& file) {
  return file.extension() == ".mcap" || is_velodyne_recording(file) || is_sick_recording(file);
}

Result<SampleKind> kind_of_channel(const std::filesystem::path& file, const std::string& channel,
                                   std::span<const SampleKind> kinds) {
  if (is_velodyne_recording(file) || is_sick_recording(file)) return SampleKind::point_cloud;
  const auto reader = record::McapReader::open(file.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  std::set<std::string> there;
  for (const SampleKind k : kinds) {
    const KindOfTopic* kind = kind_of(k);
    if (kind == nullptr) continue;
    for (const std::string& topic : topics_of(**reader, *kind)) {
      there.insert(channel_of(topic, *kind));
      if (topic == channel || channel_of(topic, *kind) == channel) return k;
    }
  }
  return fail(ErrorCode::bad_input, file.string(),
              "expected a channel " + channel +
                  ", found none of that name; those that there are: " + joined({there.begin(), there.end()}));
}

Result<RecordingInput> read_samples(const std::filesystem::path& file, const std::string& channel,
                                    SampleKind kind, const TakeSample& take) {
  if (is_velodyne_recording(file) || is_sick_recording(file)) {
    if (kind != SampleKind::point_cloud)
      return fail(ErrorCode::bad_input, file.string(),
                  "expected an MCAP recording, got one of LiDAR packets");
    if (is_sick_recording(file)) return read_sick_recording(file, take);
    if (is_livox_recording(file)) return read_livox_recording(file, take);
    if (const auto metadata = ouster_metadata_beside(file); !metadata.empty())
      return read_ouster_recording(file, metadata, take);
    return read_velodyne_recording(file, take);
  }
  const KindOfTopic* wanted = kind_of(kind);
  if (wanted == nullptr)
    return fail(ErrorCode::bad_input, file.string(), "this kind of sample cannot be read");
  auto reader = record::McapReader::open(file.string(), {.skip_damaged = true});
  if (!reader) return tl::unexpected<Error>(reader.error());
  const auto topic = choose_topic(**reader, file.string(), channel, *wanted);
  if (!topic) return tl::unexpected<Error>(topic.error());

  RecordingInput result;
  result.topic = *topic;
  for (const auto& note : (*reader)->health().notes) result.warnings.push_back(file.string() + ": " + note);
  record::SampleDecoder decoder(*topic);
  record::MessageFilter filter{.order = record::MessageOrder::file};
  for (const auto& [id, c] : (*reader)->channels())
    if (decoder.wants(c.topic)) filter.topics.insert(c.topic);
  auto cursor = (*reader)->messages(filter);
  record::MessageView view;
  Sample sample;
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    const auto whole = decoder.take(view);
    if (!whole) return tl::unexpected<Error>(whole.error());
    if (!*whole) continue;
    if (sample.memory().size() < decoder.size_bytes()) sample.reserve(decoder.size_bytes());
    if (auto s = decoder.fill(sample); !s) return tl::unexpected<Error>(s.error());
    if (sample.kind() != kind) continue;
    ++result.samples;
    if (!take(sample)) break;
  }
  if (cursor.skipped_segments() > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(cursor.skipped_segments()) +
                              " damaged chunks were passed over");
  if (result.samples == 0)
    return fail(ErrorCode::bad_input, file.string(),
                "expected samples of " + channel_of(*topic, *wanted) +
                    ", found none: the recording is empty" +
                    ((*reader)->health().truncated ? " or was cut short before the first" : ""));
  return result;
}

}  // namespace rigor
