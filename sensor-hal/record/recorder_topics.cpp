// Setup of a recording: the streams of its channels, the rings to the writer; and what the writer begins the
// file with: the run's metadata, and its topics.
#include <set>

#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/record/recorder_impl.h"

namespace rigor {

Result<std::uint16_t> Recorder::Impl::add_topic(const std::string& topic, std::string_view type) {
  auto it = schemas.find(type);
  if (it == schemas.end()) {
    auto id = writer->add_schema(std::string(type), "ros2msg", record::schema_text(type));
    if (!id) return id;
    it = schemas.emplace(std::string(type), *id).first;
  }
  record::ChannelOptions c;
  c.schema = it->second;
  c.topic = topic;
  c.metadata["offered_qos_profiles"] = "";
  return writer->add_channel(c);
}

Status Recorder::Impl::open(std::unique_ptr<record::ByteSink> sink) {
  std::set<std::string> names;
  for (const auto& c : channels) {
    if (c.name.empty() || !names.insert(c.name).second)
      return fail(ErrorCode::bad_input, c.name, "expected each recorded channel to have a name of its own");
  }
  to_utc = options.epoch.utc - RealtimeTime(options.epoch.bench.ns());
  auto opened = record::McapWriter::open(std::move(sink), options.writer);
  if (!opened) return tl::unexpected<Error>(opened.error());
  writer = std::move(*opened);
  streams.resize(channels.size() * 2);
  observers.resize(channels.size());
  sides.resize(channels.size());
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const RecordedChannel& c = channels[i];
    for (std::size_t side = 0; side < (c.is_pair ? 2u : 1u); ++side) {
      auto stream = std::make_unique<Stream>();
      stream->name = c.name + (c.is_pair ? std::string("/") + name_of(static_cast<PairSide>(side)) : "");
      stream->lease_budget = c.lease_budget;
      record::SampleChannel sc;
      sc.name = stream->name;
      sc.topic = "/" + stream->name + "/" + std::string(record::topic_of(c.description.kind));
      sc.frame_id = c.description.frame_id;
      sc.kind = c.description.kind;
      sc.register_names = c.description.names;
      sc.register_units = c.description.units;
      sc.to_utc = to_utc;
      stream->encoder = std::make_unique<record::SampleEncoder>(sc);
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
  return {};
}

Status Recorder::Impl::write_beginning(BenchTime t0) {
  record::Metadata run{"rigor", metadata};
  run.values["t0_ns"] = std::to_string(t0.ns());
  run.values["loop_period_ns"] = std::to_string(options.loop_period.ns());
  // In recordings of a whole period it would say the same twice.
  if (!options.loop_period.whole()) run.values["loop_rate_hz"] = rate_text(options.loop_period);
  run.values["utc_of_bench_0_ns"] = std::to_string(to_utc.ns());
  if (auto s = writer->add_metadata(run); !s) return s;
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
