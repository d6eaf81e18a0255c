// Setup of a recording: the streams of its channels, the rings to the writer; and what the writer begins the
// file with: the run's metadata, and its topics.
#include <set>

#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/record/recorder_impl.h"
#include "sensor-hal/record/ros2_time.h"

namespace rigor {

record::SampleChannel sample_channel(const RecordedChannel& c, PairSide side, Duration to_utc,
                                     const std::string& root_frame) {
  record::SampleChannel sc;
  sc.name = c.name;
  if (c.is_pair) sc.name += std::string("/") + name_of(side);
  sc.topic = "/" + sc.name + "/" + std::string(record::topic_of(c.description.kind));
  sc.frame_id = c.description.frame_id;
  sc.kind = c.description.kind;
  sc.register_names = c.description.names;
  sc.register_units = c.description.units;
  sc.to_utc = to_utc;
  sc.points = c.points;
  sc.scan = side == PairSide::real ? c.scan : c.simulated_scan;
  sc.root_frame = root_frame;
  return sc;
}

namespace {
/// Keep the last, reliable, transient local: whoever plays the file latches what was sent once. The numbers
/// are those of rosbag2's profiles.
constexpr const char* kLatched = R"(- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
)";
}  // namespace

Result<std::uint16_t> Recorder::Impl::add_topic(const std::string& topic, std::string_view type,
                                                const char* qos) {
  auto it = schemas.find(type);
  if (it == schemas.end()) {
    auto id = writer->add_schema(std::string(type), "ros2msg", record::schema_text(type));
    if (!id) return id;
    it = schemas.emplace(std::string(type), *id).first;
  }
  record::ChannelOptions c;
  c.schema = it->second;
  c.topic = topic;
  c.metadata["offered_qos_profiles"] = qos;
  return writer->add_channel(c);
}

Status Recorder::Impl::open(std::unique_ptr<record::MessageWriter> to) {
  std::set<std::string> names;
  for (const auto& c : channels) {
    if (c.name.empty() || !names.insert(c.name).second)
      return fail(ErrorCode::bad_input, c.name, "expected each recorded channel to have a name of its own");
  }
  to_utc = options.epoch.utc - RealtimeTime(options.epoch.bench.ns());
  writer = std::move(to);
  streams.resize(channels.size() * 2);
  observers.resize(channels.size());
  sides.resize(channels.size());
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const RecordedChannel& c = channels[i];
    if (!c.wanted) continue;
    for (std::size_t side = 0; side < (c.is_pair ? 2u : 1u); ++side) {
      auto stream = std::make_unique<Stream>();
      stream->name = sample_channel(c, static_cast<PairSide>(side), to_utc, options.root_frame).name;
      stream->lease_budget = c.lease_budget;
      stream->encoder = std::make_unique<record::SampleEncoder>(
          sample_channel(c, static_cast<PairSide>(side), to_utc, options.root_frame));
      if (c.camera && c.description.kind == SampleKind::image) {
        stream->camera = c.camera;
        stream->camera->header.frame_id = c.description.frame_id;
      }
      streams[i * 2 + side] = std::move(stream);
    }
  }
  options.places = std::max<std::size_t>(options.places, 64);
  copies = make_sample_pool(options.places, kCopyBytes);
  ring.emplace(options.places);
  want_motion = options.clock || (options.frames && options.frames->moves());
  if (!options.live) return {};
  if (auto s = add_topics(); !s) return s;
  return add_motion_topics();
}

/// In front of all samples: whoever reads the file in its order knows the frames before it needs them.
Status Recorder::Impl::add_frames() {
  if (options.frames) {
    const record::msg::TFMessage fixed = options.frames->fixed(record::to_time(t0.ns() + to_utc.ns()));
    if (!fixed.transforms.empty()) {
      const auto id = add_topic("/tf_static", record::msg::TFMessage::kType, kLatched);
      if (!id) return tl::unexpected<Error>(id.error());
      const auto pieces = cdr.write(fixed);
      if (!pieces) return tl::unexpected<Error>(pieces.error());
      record::MessageInfo info;
      info.channel = *id;
      info.log_time_ns = info.publish_time_ns = log_time(t0);
      if (auto s = writer->write(info, *pieces); !s) return s;
    }
  }
  return add_motion_topics();
}

Status Recorder::Impl::add_motion_topics() {
  if (options.frames && options.frames->moves() && tf_id == 0) {
    const auto id = add_topic("/tf", record::msg::TFMessage::kType);
    if (!id) return tl::unexpected<Error>(id.error());
    tf_id = *id;
  }
  if (!options.clock || clock_id != 0) return {};
  const auto id = add_topic("/clock", record::msg::Clock::kType);
  if (!id) return tl::unexpected<Error>(id.error());
  clock_id = *id;
  return {};
}

Status Recorder::Impl::write_beginning(BenchTime begin) {
  t0 = begin;
  record::Metadata run{"rigor", metadata};
  run.values["t0_ns"] = std::to_string(t0.ns());
  run.values["loop_period_ns"] = std::to_string(options.loop_period.ns());
  // In recordings of a whole period it would say the same twice.
  if (!options.loop_period.whole()) run.values["loop_rate_hz"] = rate_text(options.loop_period);
  run.values["utc_of_bench_0_ns"] = std::to_string(to_utc.ns());
  if (auto s = writer->add_metadata(run); !s) return s;
  if (!options.live)
    if (auto s = add_topics(); !s) return s;
  return add_frames();
}

Status Recorder::Impl::add_topics() {
  for (const auto& stream : streams) {
    if (!stream) continue;
    for (const auto& s : stream->encoder->streams()) {
      auto id = add_topic(s.topic, s.type);
      if (!id) return tl::unexpected<Error>(id.error());
      stream->ids.push_back(*id);
    }
    if (!stream->camera) continue;
    auto id = add_topic("/" + stream->name + "/camera_info", record::msg::CameraInfo::kType);
    if (!id) return tl::unexpected<Error>(id.error());
    stream->camera_id = *id;
  }
  for (auto [topic, type, id] :
       {std::tuple("/rigor/visibility", record::msg::PortVisibility::kType, &visibility_id),
        std::tuple("/rigor/events", record::msg::Event::kType, &events_id),
        std::tuple("/rigor/faults", record::msg::Fault::kType, &faults_id),
        std::tuple("/rigor/commands", record::msg::Command::kType, &commands_id)}) {
    auto added = add_topic(topic, type);
    if (!added) return tl::unexpected<Error>(added.error());
    *id = *added;
  }

  if (std::any_of(channels.begin(), channels.end(), [](const auto& c) { return !c.watched.empty(); })) {
    auto added = add_topic("/diagnostics", record::msg::DiagnosticArray::kType);
    if (!added) return tl::unexpected<Error>(added.error());
    diagnostics_id = *added;
  }
  return {};
}

}  // namespace rigor
