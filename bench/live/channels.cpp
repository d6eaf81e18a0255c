#include "bench/live/channels.h"

#include <algorithm>

#include "bench/files/picture.h"
#include "bench/run/recording.h"
#include "sensor-hal/record/fault_message.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/ros2_time.h"

namespace rigor::live {
namespace {

ChannelInfo ros_channel(std::string topic, std::string_view type) {
  return {0, std::move(topic), "cdr", std::string(type), "ros2msg", record::schema_text(type)};
}

/// Numbers over time, a few in a message.
bool is_numbers(SampleKind kind) {
  return kind == SampleKind::register_block || kind == SampleKind::pose || kind == SampleKind::imu ||
         kind == SampleKind::nav_fix || kind == SampleKind::odometry;
}

Bytes joined(record::Pieces pieces) {
  std::size_t size = 0;
  for (const auto& piece : pieces) size += piece.size();
  auto all = std::make_shared<std::string>();
  all->reserve(size);
  for (const auto& piece : pieces) all->append(reinterpret_cast<const char*>(piece.data()), piece.size());
  return all;
}

}  // namespace

std::vector<LiveTap::StreamSpec> stream_specs(const RunParts& parts) {
  std::vector<LiveTap::StreamSpec> specs;
  for (const auto& c : parts.channels) {
    const std::size_t bytes = c->source->describe().max_bytes;
    specs.push_back({true, bytes});
    specs.push_back({c->pair != nullptr, bytes});
  }
  return specs;
}

LiveChannels::LiveChannels(const RunParts& parts, const EpochPair& epoch) : epoch_(epoch) {
  const auto channels = recorded_channels(parts);  // what can be wrong in it, the assembly has refused
  const Duration to_utc = epoch.utc - RealtimeTime(epoch.bench.ns());
  for (const RecordedChannel& c : channels ? *channels : std::vector<RecordedChannel>{}) {
    channel_names_.push_back(c.name);
    for (std::size_t side = 0; side < 2; ++side) {
      Stream s;
      s.used = side == 0 || c.is_pair;
      if (s.used) {
        const record::SampleChannel sc =
            sample_channel(c, static_cast<PairSide>(side), to_utc, parts.rig.frames.root);
        s.topic = sc.topic;
        s.frame_id = sc.frame_id;
        s.kind = sc.kind;
        s.max_bytes = c.description.max_bytes;
        s.encoder = std::make_unique<record::SampleEncoder>(sc);
        s.camera = c.camera;
        s.camera_topic = "/" + sc.name + "/camera_info";
      }
      streams_.push_back(std::move(s));
    }
  }
  if (auto frames = frame_source(parts, epoch)) frames_ = std::move(*frames);
  virtual_time_ = parts.rig.clock == ClockKind::virtual_time;
  clock_ = parts.rig.frames.publish && virtual_time_;
  for (const auto& sink : parts.sinks) {
    sink_names_.push_back(sink->entry->name);
    value_names_.push_back(sink->sink->describe().names);
  }
}

std::uint64_t LiveChannels::utc_ns(BenchTime t) const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, epoch_.to_utc(t).ns()));
}

record::msg::Header LiveChannels::header(BenchTime t, const std::string& frame_id) const {
  const std::uint64_t ns = utc_ns(t);
  record::msg::Header h;
  h.stamp = {static_cast<std::int32_t>(ns / 1'000'000'000), static_cast<std::uint32_t>(ns % 1'000'000'000)};
  h.frame_id = frame_id;
  return h;
}

void LiveChannels::add_to(Hub& hub) {
  for (Stream& s : streams_) {
    if (!s.used) continue;
    for (const auto& stream : s.encoder->streams())
      s.ids.push_back(hub.add_channel(ros_channel(stream.topic, stream.type), Hub::Delivery::newest));
    s.kept = is_numbers(s.kind);
    if (s.kept)
      for (const std::uint32_t id : s.ids) hub.keep(id, MessageHistory::Keep::thinned);
    if (s.kind != SampleKind::image) continue;
    s.small_id = hub.add_channel(ros_channel(s.topic + "/small", record::msg::CompressedImage::kType),
                                 Hub::Delivery::newest);
    if (s.camera)
      s.camera_id =
          hub.add_channel(ros_channel(s.camera_topic, record::msg::CameraInfo::kType), Hub::Delivery::newest);
  }
  if (frames_) {
    tf_static_id_ =
        hub.add_channel(ros_channel("/tf_static", record::msg::TFMessage::kType), Hub::Delivery::latched);
    if (frames_->moves())
      tf_id_ = hub.add_channel(ros_channel("/tf", record::msg::TFMessage::kType), Hub::Delivery::newest);
  }
  if (clock_)
    clock_id_ = hub.add_channel(ros_channel("/clock", record::msg::Clock::kType), Hub::Delivery::newest);
  events_id_ = hub.add_channel(ros_channel("/rigor/events", record::msg::Event::kType));
  hub.keep(events_id_, MessageHistory::Keep::newest);
  faults_id_ = hub.add_channel(ros_channel("/rigor/faults", record::msg::Fault::kType));
  commands_id_ = hub.add_channel(ros_channel("/rigor/commands", record::msg::Command::kType));
}

bool LiveChannels::listened(const Hub& hub, const Stream& s) {
  return std::any_of(s.ids.begin(), s.ids.end(), [&](std::uint32_t id) { return hub.subscribed_now(id); }) ||
         (s.small_id != 0 && hub.subscribed_now(s.small_id)) ||
         (s.camera_id != 0 && hub.subscribed_now(s.camera_id));
}

void LiveChannels::pump(Hub& hub, LiveTap& tap, LiveEstimate* estimate) {
  ++tick_;
  for (std::size_t i = 0; i < streams_.size(); ++i) {
    Stream& s = streams_[i];
    if (!s.used) continue;
    const bool heard = listened(hub, s), truth = estimate && estimate->truth_stream() == i;
    // Taken also where nobody listens any more: no slot is held for nothing.
    if (const SampleLease sample = tap.take(i)) {
      if (heard || s.kept) publish(hub, s, *sample);
      if (truth) estimate->truth(*sample);
    }
    if (!(heard || s.kept || truth) || tick_ < s.next_tick) continue;
    tap.want(i);
    s.next_tick = tick_ + (!heard && !truth ? kUnheardTicks : s.max_bytes > kLarge ? 2 : 1);
  }
  publish_events(hub, tap, estimate);
  publish_frames(hub, tap);
  hub.advance(utc_ns(tap.now()));
}

void LiveChannels::publish_frames(Hub& hub, LiveTap& tap) {
  const BenchTime now = tap.now();
  // In a wall-clock run, bench time is known from the first cycle on.
  if (tf_static_id_ != 0 && !fixed_told_ && (virtual_time_ || now.ns() > 0)) {
    fixed_told_ = true;
    // Latched: it is encoded whether or not anybody listens yet.
    if (const auto pieces = cdr_.write(frames_->fixed(record::to_time(epoch_.to_utc(now).ns()))))
      hub.publish(tf_static_id_, utc_ns(now), joined(*pieces));
  }
  if (tf_id_ != 0 && hub.wanted(tf_id_)) {
    const LiveTap::MotionAt at = tap.motion();
    tap.want_motion();
    if (at.count > 0 && at.count != motion_count_ &&
        frames_->moving(at.motion, at.t, tap.t0(), record::to_time(epoch_.to_utc(at.t).ns()), transforms_))
      publish_message(hub, tf_id_, at.t, transforms_);
    motion_count_ = at.count;
  }
  if (clock_id_ != 0 && hub.wanted(clock_id_) && now != clock_told_) {
    clock_told_ = now;
    publish_message(hub, clock_id_, now, record::msg::Clock{record::to_time(epoch_.to_utc(now).ns())});
  }
}

template <class M>
void LiveChannels::publish_message(Hub& hub, std::uint32_t id, BenchTime t, const M& message) {
  if (!hub.wanted(id)) return;
  if (const auto pieces = cdr_.write(message)) hub.publish(id, utc_ns(t), joined(*pieces));
}

void LiveChannels::publish(Hub& hub, Stream& s, const Sample& sample) {
  const BenchTime t = sample.stamp.t_release;
  if (const auto messages = s.encoder->encode(sample))
    for (const auto& m : *messages)
      if (const std::uint32_t id = s.ids[m.stream]; hub.wanted(id))
        hub.publish(id, utc_ns(t), joined(m.pieces));
  const auto* image = sample.as<ImageInfo>();
  if (!image) return;
  if (s.camera_id != 0 && hub.wanted(s.camera_id)) {
    record::msg::CameraInfo info = *s.camera;
    info.header = header(sample.stamp.t_capture, s.frame_id);
    info.roi.x_offset = image->offset_x_px;
    info.roi.y_offset = image->offset_y_px;
    publish_message(hub, s.camera_id, t, info);
  }
  if (!hub.wanted(s.small_id)) return;
  const auto file = small_jpeg(*image, sample.bytes(), kSmallWidth_px);
  if (!file) return;  // a picture of depths, or one that is cut short: it has no small one
  record::msg::CompressedImage small;
  small.header = header(sample.stamp.t_capture, s.frame_id);
  small.format = "jpeg";
  small.data = std::as_bytes(std::span(*file));
  publish_message(hub, s.small_id, t, small);
}

void LiveChannels::publish_events(Hub& hub, LiveTap& tap, LiveEstimate* estimate) {
  for (LiveEvent e; tap.take(e);) {
    record::msg::Event m;
    m.header = header(e.t, "");
    if (e.channel < channel_names_.size()) m.channel = channel_names_[e.channel];
    m.kind = event_kind(e.info.code);
    m.code = e.info.code;
    m.value = e.info.value;
    m.text.assign(e.info.text.begin(), std::find(e.info.text.begin(), e.info.text.end(), '\0'));
    publish_message(hub, events_id_, e.t, m);
  }
  for (FaultChange change; tap.take(change);) {
    record::msg::Fault m = fault_message(change);
    m.header = header(change.t, "");
    publish_message(hub, faults_id_, change.t, m);
  }
  for (LiveCommand c; tap.take(c);) {
    if (c.sink >= sink_names_.size()) continue;
    if (estimate) estimate->told(c.sink, c.command);
    record::msg::Command m;
    m.header = header(c.command.t_issue, "");
    m.channel = sink_names_[c.sink];
    m.names = value_names_[c.sink];
    m.sequence = c.command.sequence;
    m.t_effect_ns = c.command.t_effect.ns();
    const std::size_t n = std::min<std::size_t>(c.command.count, c.command.value.size());
    m.values.assign(c.command.value.begin(), c.command.value.begin() + static_cast<std::ptrdiff_t>(n));
    publish_message(hub, commands_id_, c.command.t_issue, m);
  }
}

}  // namespace rigor::live
