#include "sensor-hal/record/sample_codec.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sensor-hal/record/ros2_time.h"

namespace rigor::record {
namespace {

constexpr std::size_t kStamp = 0;
constexpr std::size_t kMain = 1;
constexpr std::size_t kCompanion = 2;

// Of formats with one encoding the first is what an image of others means; in our own recordings the
// settings beside it name the format.
constexpr std::array<std::pair<PixelFormat, std::string_view>, kPixelFormats.size() + kVideoFormats.size()>
    kEncodings{{{PixelFormat::mono8, "mono8"},
                {PixelFormat::mono12p, "mono12p"},
                {PixelFormat::mono16, "mono16"},
                {PixelFormat::mono10, "mono16"},
                {PixelFormat::mono12, "mono16"},
                {PixelFormat::bayer_rg8, "bayer_rggb8"},
                {PixelFormat::bayer_rg16, "bayer_rggb16"},
                {PixelFormat::bayer_rg10, "bayer_rggb16"},
                {PixelFormat::bayer_rg12, "bayer_rggb16"},
                {PixelFormat::rgb8, "rgb8"},
                {PixelFormat::yuv422_8, "yuv422_yuy2"},
                {PixelFormat::yuv420_sp, "nv12"},
                {PixelFormat::coord3d_c16, "16UC1"}}};

std::string_view encoding_of(PixelFormat format) {
  for (const auto& [f, name] : kEncodings)
    if (f == format) return name;
  return "";
}

Error protocol(const MessageView& message, std::string what) {
  return {ErrorCode::protocol, message.channel->topic, std::move(what)};
}

/// Bytes of a plane, or none where the product is larger than anything that can lie in a message.
std::optional<std::uint64_t> plane_bytes(std::uint32_t width, std::uint32_t height, std::uint64_t bits) {
  const std::uint64_t pixels = std::uint64_t{width} * height;
  if (pixels > (std::uint64_t{1} << 40)) return std::nullopt;
  return (pixels * bits + 7) / 8;
}

}  // namespace

std::string_view topic_of(SampleKind kind) {
  switch (kind) {
    case SampleKind::image:
      return "image";
    case SampleKind::range_image:
      return "range";
    case SampleKind::point_cloud:
      return "points";
    case SampleKind::can_frame:
      return "can";
    case SampleKind::register_block:
      return "registers";
    case SampleKind::pose:
      return "pose";
    case SampleKind::event:
      return "events";
    case SampleKind::imu:
      return "imu";
    case SampleKind::nav_fix:
      return "fix";
    case SampleKind::odometry:
      return "odometry";
    case SampleKind::none:
      break;
  }
  return "samples";
}

SampleEncoder::SampleEncoder(SampleChannel channel) : channel_(std::move(channel)) {
  const std::string& topic = channel_.topic;
  streams_.push_back({topic + "/stamp", msg::SampleStamp::kType});
  switch (channel_.kind) {
    case SampleKind::none:
      break;
    case SampleKind::image:
      streams_.push_back({topic, msg::Image::kType});
      streams_.push_back({topic + "/settings", msg::ImageSettings::kType});
      break;
    case SampleKind::range_image:
      streams_.push_back({topic, msg::Image::kType});
      streams_.push_back({topic + "/amplitude", msg::Image::kType});
      break;
    case SampleKind::point_cloud:
      streams_.push_back({topic, msg::PointCloud2::kType});
      if (channel_.points != PointLayout::rigor)
        streams_.push_back({topic + "/timing", msg::PointCloud2::kType});
      if (channel_.scan) {
        scan_stream_ = streams_.size();
        streams_.push_back({topic.substr(0, topic.rfind('/')) + "/scan", msg::LaserScan::kType});
      }
      break;
    case SampleKind::can_frame:
      streams_.push_back({topic, msg::Frame::kType});
      streams_.push_back({topic + "/fd", msg::CanFdFrame::kType});
      break;
    case SampleKind::register_block:
      streams_.push_back({topic, msg::RegisterBlock::kType});
      break;
    case SampleKind::pose:
      streams_.push_back({topic, msg::PoseStamped::kType});
      break;
    case SampleKind::event:
      streams_.push_back({topic, msg::Event::kType});
      break;
    case SampleKind::imu:
      streams_.push_back({topic, msg::Imu::kType});
      streams_.push_back({topic + "/temperature", msg::Temperature::kType});
      break;
    case SampleKind::nav_fix:
      streams_.push_back({topic, msg::NavSatFix::kType});
      streams_.push_back({topic + "/quality", msg::NavFixQuality::kType});
      break;
    case SampleKind::odometry:
      streams_.push_back({topic, msg::Odometry::kType});
      streams_.push_back({topic + "/wheels", msg::JointState::kType});
      break;
  }
  registers_.names = channel_.register_names;
  registers_.units = channel_.register_units;
}

template <class M>
Status SampleEncoder::add(std::size_t stream, const M& message) {
  auto pieces = writers_[messages_.size()].write(message);
  if (!pieces) return tl::unexpected(pieces.error());
  messages_.push_back({stream, *pieces});
  return {};
}

msg::Header SampleEncoder::header(const Sample& sample) const {
  return {to_time(sample.stamp.t_capture.ns() + channel_.to_utc.ns()), channel_.frame_id};
}

Status SampleEncoder::wrong_size(std::size_t expected, const Sample& sample) const {
  return fail(ErrorCode::internal, channel_.name,
              "expected a sample of " + std::to_string(expected) + " bytes, got " +
                  std::to_string(sample.size_bytes));
}

Result<std::span<const SampleMessage>> SampleEncoder::encode(const Sample& sample) {
  messages_.clear();
  const Stamp& stamp = sample.stamp;
  stamp_.channel = channel_.name;
  stamp_.sequence = stamp.sequence;
  stamp_.t_capture_ns = stamp.t_capture.ns();
  stamp_.t_release_ns = stamp.t_release.ns();
  stamp_.t_arrival_ns = stamp.t_arrival.ns();
  stamp_.sigma_capture_ns = stamp.sigma_capture.ns();
  stamp_.lost_before = stamp.lost_before;
  stamp_.validity = stamp.validity;
  stamp_.kind = static_cast<std::uint8_t>(sample.kind());
  if (Status status = add(kStamp, stamp_); !status) return tl::unexpected(status.error());
  if (sample.kind() == SampleKind::none) return std::span<const SampleMessage>(messages_);
  if (sample.kind() != channel_.kind)
    return fail(ErrorCode::internal, channel_.name, "a sample is of another kind than its channel");
  if (Status status = add_content(sample); !status) return tl::unexpected(status.error());
  return std::span<const SampleMessage>(messages_);
}

Status SampleEncoder::add_content(const Sample& sample) {
  if (const auto* image = sample.as<ImageInfo>()) return add_image(sample, *image);
  if (const auto* range = sample.as<RangeImageInfo>()) return add_range_image(sample, *range);
  if (const auto* cloud = sample.as<PointCloudInfo>()) return add_point_cloud(sample, *cloud);
  if (const auto* frame = sample.as<CanFrame>()) return add_can(sample, *frame);
  if (const auto* imu = sample.as<ImuSample>()) return add_imu(sample, *imu);
  if (const auto* fix = sample.as<NavFix>()) return add_nav_fix(sample, *fix);
  if (const auto* odometry = sample.as<Odometry>()) return add_odometry(sample, *odometry);
  if (const auto* block = sample.as<RegisterBlock>()) {
    if (block->count > RegisterBlock::kMax) return wrong_size(RegisterBlock::kMax, sample);
    registers_.header = header(sample);
    registers_.values.assign(block->value.begin(), block->value.begin() + block->count);
    return add(kMain, registers_);
  }
  if (const auto* pose = sample.as<Pose>()) {
    const auto& p = pose->position_m;
    const auto& q = pose->orientation_wxyz;
    msg::Header head = header(sample);
    head.frame_id = channel_.root_frame;
    return add(kMain, msg::PoseStamped{head, {{p[0], p[1], p[2]}, {q[1], q[2], q[3], q[0]}}});
  }
  if (const auto* event = sample.as<EventInfo>()) {
    const auto end = std::find(event->text.begin(), event->text.end(), '\0');
    return add(kMain, msg::Event{header(sample), channel_.name, "event", event->code, event->value,
                                 std::string(event->text.begin(), end)});
  }
  return {};
}

Status SampleEncoder::add_image(const Sample& sample, const ImageInfo& info) {
  const std::size_t size = image_bytes(info.format, info.width_px, info.height_px);
  if (sample.size_bytes != size) return wrong_size(size, sample);
  const msg::Header head = header(sample);
  if (Status status =
          add(kCompanion, msg::ImageSettings{head, std::string(pfnc_name(info.format)), info.offset_x_px,
                                             info.offset_y_px, info.exposure.ns(), info.gain_db});
      !status)
    return status;
  const auto step = static_cast<std::uint32_t>((info.width_px * bits_per_pixel(info.format) + 7) / 8);
  return add(kMain, msg::Image{head, info.height_px, info.width_px, std::string(encoding_of(info.format)), 0,
                               step, sample.bytes()});
}

Status SampleEncoder::add_range_image(const Sample& sample, const RangeImageInfo& info) {
  const std::size_t plane = std::size_t{info.width_px} * info.height_px * sizeof(float);
  if (sample.size_bytes != plane && sample.size_bytes != 2 * plane) return wrong_size(2 * plane, sample);
  const auto step = static_cast<std::uint32_t>(info.width_px * sizeof(float));
  const msg::Header head = header(sample);
  const auto image = [&](Bytes pixels) {
    return msg::Image{head, info.height_px, info.width_px, "32FC1", 0, step, pixels};
  };
  if (sample.size_bytes > plane)
    if (Status status = add(kCompanion, image(sample.bytes().subspan(plane))); !status) return status;
  return add(kMain, image(sample.bytes().first(plane)));
}

Status SampleEncoder::add_point_cloud(const Sample& sample, const PointCloudInfo& info) {
  const std::size_t size = info.count * sizeof(LidarPoint);
  if (sample.size_bytes != size) return wrong_size(size, sample);
  const std::span<const LidarPoint> points{reinterpret_cast<const LidarPoint*>(sample.bytes().data()),
                                           info.count};
  const PointLayout layout = channel_.points;
  const std::uint32_t step = point_step(layout);
  msg::PointCloud2 cloud{header(sample), 1,    info.count, {}, false, step, step * info.count,
                         sample.bytes(), false};
  cloud.fields_ = point_fields(layout);
  if (layout != PointLayout::rigor) {
    pack_timing(points, timing_);
    if (Status status =
            add(kCompanion, msg::PointCloud2{cloud.header, 1, info.count, timing_fields(), false, kTimingStep,
                                             kTimingStep * info.count, timing_, true});
        !status)
      return status;
    const std::int32_t offset = header_offset_ns(layout, points);
    const std::int64_t header_utc_ns = sample.stamp.t_capture.ns() + channel_.to_utc.ns() + offset;
    cloud.header.stamp = to_time(header_utc_ns);
    pack_points(layout, points, offset, header_utc_ns, points_);
    cloud.data = points_;
    // Samples hold what came back and nothing else, which LIO-SAM asks for.
    cloud.is_dense = true;
  }
  if (Status status = add(kMain, cloud); !status || !channel_.scan) return status;
  if (!scan_aligned_) scan_aligned_ = align(*channel_.scan, points);
  fill_laser_scan(*channel_.scan, points, (sample.stamp.validity & kIncomplete) != 0, scan_);
  scan_.header = header(sample);
  return add(scan_stream_, scan_);
}

Status SampleEncoder::add_can(const Sample& sample, const CanFrame& frame) {
  if (frame.length > frame.data.size()) return wrong_size(frame.data.size(), sample);
  if (frame.fd || frame.bit_rate_switch || frame.length > 8)
    return add(kCompanion, msg::CanFdFrame{header(sample), frame.id, frame.remote, frame.extended,
                                           frame.error, frame.fd, frame.bit_rate_switch,
                                           std::as_bytes(std::span(frame.data)).first(frame.length)});
  msg::Frame message{header(sample), frame.id, frame.remote, frame.extended, frame.error, frame.length, {}};
  std::copy_n(frame.data.begin(), message.data.size(), message.data.begin());
  return add(kMain, message);
}

Status SampleEncoder::add_imu(const Sample& sample, const ImuSample& imu) {
  const msg::Header head = header(sample);
  if (!std::isnan(imu.temperature_c))
    if (Status status = add(kCompanion, msg::Temperature{head, imu.temperature_c, 0}); !status) return status;
  const auto& f = imu.specific_force_mps2;
  const auto& w = imu.angular_rate_radps;
  msg::Imu message{head, {}, {}, {w[0], w[1], w[2]}, {}, {f[0], f[1], f[2]}, {}};
  message.orientation_covariance[0] = -1;  // sensor_msgs/Imu: no estimate of the orientation
  return add(kMain, message);
}

Status SampleEncoder::add_nav_fix(const Sample& sample, const NavFix& fix) {
  constexpr std::int8_t kNoFix = -1, kFix = 0, kSbas = 1, kGbas = 2;
  constexpr std::uint8_t kUnknown = 0, kKnown = 3;
  constexpr std::uint16_t kGps = 1;
  std::int8_t status = kNoFix;
  switch (fix.status) {
    case FixStatus::none:
      break;
    case FixStatus::fix:
      status = kFix;
      break;
    case FixStatus::sbas:
      status = kSbas;
      break;
    case FixStatus::rtk_float:
    case FixStatus::rtk_fixed:
      status = kGbas;
      break;
  }
  const msg::Header head = header(sample);
  if (Status s =
          add(kCompanion, msg::NavFixQuality{head, static_cast<std::uint8_t>(fix.status), fix.satellites});
      !s)
    return s;
  return add(kMain, msg::NavSatFix{head,
                                   {status, kGps},
                                   fix.latitude_deg,
                                   fix.longitude_deg,
                                   fix.height_m,
                                   fix.covariance_enu_m2,
                                   fix.status == FixStatus::none ? kUnknown : kKnown});
}

Status SampleEncoder::add_odometry(const Sample& sample, const Odometry& odometry) {
  const auto& o = odometry;
  const msg::Header head = header(sample);
  const auto pair = [](const std::array<double, 2>& v) { return std::vector<double>(v.begin(), v.end()); };
  if (Status status = add(
          kCompanion,
          msg::JointState{head, {"left", "right"}, pair(o.wheel_angle_rad), pair(o.wheel_rate_radps), {}});
      !status)
    return status;
  const auto& p = o.T_odom_base.position_m;
  const auto& q = o.T_odom_base.orientation_wxyz;
  const auto& v = o.velocity_mps;
  const auto& w = o.turn_rate_radps;
  msg::Odometry message{{head.stamp, "odom"},
                        channel_.frame_id,
                        {{{p[0], p[1], p[2]}, {q[1], q[2], q[3], q[0]}}, {}},
                        {{{v[0], v[1], v[2]}, {w[0], w[1], w[2]}}, {}}};
  for (std::size_t i = 0; i < 6; ++i) {
    message.pose.covariance[i * 7] = o.pose_variance[i];
    message.twist.covariance[i * 7] = o.twist_variance[i];
  }
  return add(kMain, message);
}

bool SampleDecoder::wants(std::string_view topic) const {
  if (!topic.starts_with(topic_)) return false;
  const std::string_view rest = topic.substr(topic_.size());
  return rest.empty() ||
         std::find(kCompanionTopics.begin(), kCompanionTopics.end(), rest) != kCompanionTopics.end();
}

void SampleDecoder::stamp_from(const msg::Header& header, const MessageView& message) {
  if (stamped_) return;
  const std::int64_t utc_ns = to_ns(header.stamp);
  stamp_ = {};
  stamp_.sequence = message.sequence;
  stamp_.t_capture = BenchTime(utc_ns - to_utc_.ns());
  stamp_.t_release = stamp_.t_arrival =
      BenchTime(static_cast<std::int64_t>(message.log_time_ns) - to_utc_.ns());
}

Result<bool> SampleDecoder::take(const MessageView& message) {
  const std::string_view topic = message.channel->topic;
  if (!wants(topic)) return false;
  const std::string_view companion = topic.substr(topic_.size());
  if (companion == "/stamp") {
    msg::SampleStamp stamp;
    if (Status status = CdrReader::read(message.data, stamp); !status)
      return tl::unexpected(protocol(message, status.error().message));
    stamp_ = {stamp.sequence,
              BenchTime(stamp.t_capture_ns),
              BenchTime(stamp.t_release_ns),
              BenchTime(stamp.t_arrival_ns),
              Duration(stamp.sigma_capture_ns),
              stamp.lost_before,
              stamp.validity};
    stamped_kind_ = static_cast<SampleKind>(stamp.kind);
    stamped_sequence_ = message.sequence;
    stamped_ = true;
    settings_.reset();
    amplitude_.clear();
    timing_.reset();
    temperature_.reset();
    quality_.reset();
    wheels_.reset();
    main_bytes_ = second_bytes_ = {};
    info_ = std::monostate{};
    return stamped_kind_ == SampleKind::none;
  }
  if (stamped_ && message.sequence != stamped_sequence_) stamped_ = false;  // its stamp was lost
  if (companion == "/amplitude") {
    msg::Image image;
    if (Status status = CdrReader::read(message.data, image); !status)
      return tl::unexpected(protocol(message, status.error().message));
    amplitude_.assign(image.data.begin(), image.data.end());
    return false;
  }
  if (companion == "/timing") {
    timing_.emplace(message.data.begin(), message.data.end());
    return false;
  }
  const auto keep = [&](auto& companion_message) -> Result<bool> {
    companion_message.emplace();
    if (Status status = CdrReader::read(message.data, *companion_message); !status)
      return tl::unexpected(protocol(message, status.error().message));
    return false;
  };
  if (companion == "/settings") return keep(settings_);
  if (companion == "/temperature") return keep(temperature_);
  if (companion == "/quality") return keep(quality_);
  if (companion == "/wheels") return keep(wheels_);
  main_bytes_ = second_bytes_ = {};
  if (Status status = decode(message); !status)
    return tl::unexpected(protocol(message, status.error().message));
  if (stamped_ && info_.index() != static_cast<std::size_t>(stamped_kind_))
    return tl::unexpected(protocol(message, "the message and its stamp are of different kinds"));
  stamped_ = false;
  return true;
}

Status SampleDecoder::decode(const MessageView& message) {
  const std::string_view type = message.schema != nullptr ? std::string_view(message.schema->name) : "";
  if (message.channel->message_encoding != "cdr")
    return fail(ErrorCode::protocol, "",
                "expected messages encoded as cdr, got " + message.channel->message_encoding);
  if (type == msg::Image::kType) return decode_image(message);
  if (type == msg::PointCloud2::kType) return decode_point_cloud(message);
  if (type == msg::Imu::kType) return decode_imu(message);
  if (type == msg::NavSatFix::kType) return decode_nav_fix(message);
  if (type == msg::Odometry::kType) return decode_odometry(message);
  if (type == msg::Frame::kType) {
    msg::Frame m;
    if (Status status = CdrReader::read(message.data, m); !status) return status;
    if (m.dlc > m.data.size()) return fail(ErrorCode::protocol, "", "a CAN frame states more than 8 bytes");
    CanFrame frame{m.id, m.is_extended, m.is_rtr, m.is_error, false, false, m.dlc, {}};
    std::copy(m.data.begin(), m.data.end(), frame.data.begin());
    stamp_from(m.header, message);
    info_ = frame;
    return {};
  }
  if (type == msg::CanFdFrame::kType) {
    msg::CanFdFrame m;
    if (Status status = CdrReader::read(message.data, m); !status) return status;
    CanFrame frame{m.id,
                   m.is_extended,
                   m.is_rtr,
                   m.is_error,
                   m.is_fd,
                   m.bit_rate_switch,
                   static_cast<std::uint8_t>(m.data.size()),
                   {}};
    if (m.data.size() > frame.data.size())
      return fail(ErrorCode::protocol, "", "a CAN FD frame holds more than 64 bytes");
    std::memcpy(frame.data.data(), m.data.data(), m.data.size());
    stamp_from(m.header, message);
    info_ = frame;
    return {};
  }
  if (type == msg::RegisterBlock::kType) {
    msg::RegisterBlock m;
    if (Status status = CdrReader::read(message.data, m); !status) return status;
    RegisterBlock block;
    if (m.values.size() > RegisterBlock::kMax)
      return fail(ErrorCode::protocol, "",
                  "a register block holds more than " + std::to_string(RegisterBlock::kMax) + " values");
    block.count = static_cast<std::uint32_t>(m.values.size());
    std::copy(m.values.begin(), m.values.end(), block.value.begin());
    stamp_from(m.header, message);
    info_ = block;
    return {};
  }
  if (type == msg::PoseStamped::kType) {
    msg::PoseStamped m;
    if (Status status = CdrReader::read(message.data, m); !status) return status;
    const auto& [p, q] = m.pose;
    stamp_from(m.header, message);
    info_ = Pose{{p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}};
    return {};
  }
  if (type == msg::Event::kType) {
    msg::Event m;
    if (Status status = CdrReader::read(message.data, m); !status) return status;
    EventInfo event{m.code, m.value, {}};
    std::copy_n(m.text.begin(), std::min(m.text.size(), event.text.size() - 1), event.text.begin());
    stamp_from(m.header, message);
    info_ = event;
    return {};
  }
  return fail(ErrorCode::protocol, "", "messages of type '" + std::string(type) + "' are no samples");
}

Status SampleDecoder::decode_image(const MessageView& message) {
  msg::Image m;
  if (Status status = CdrReader::read(message.data, m); !status) return status;
  const bool range = m.encoding == "32FC1";
  const auto* known = std::find_if(kEncodings.begin(), kEncodings.end(),
                                   [&](const auto& e) { return e.second == m.encoding; });
  if (!range && known == kEncodings.end())
    return fail(ErrorCode::protocol, "",
                "expected an image encoded as mono8, mono12p, mono16, bayer_rggb8, bayer_rggb16, rgb8, "
                "yuv422_yuy2, nv12, 16UC1 or 32FC1, got " +
                    m.encoding);
  if (m.is_bigendian != 0 && (range || has_words(known->first)))
    return fail(ErrorCode::protocol, "", "expected little-endian pixels");
  const std::uint64_t bits = range ? 32 : bits_per_pixel(known->first);
  const auto size = plane_bytes(m.width, m.height, bits);
  if (!size || *size != m.data.size())
    return fail(ErrorCode::protocol, "",
                "expected " + std::to_string(m.width) + "x" + std::to_string(m.height) + " pixels of " +
                    std::to_string(bits) + " bits without padding, got " + std::to_string(m.data.size()) +
                    " bytes");
  stamp_from(m.header, message);
  main_bytes_ = m.data;
  if (range) {
    if (stamped_ && !amplitude_.empty()) {
      if (amplitude_.size() != *size)
        return fail(ErrorCode::protocol, "", "range and amplitude differ in size");
      second_bytes_ = amplitude_;
    }
    info_ = RangeImageInfo{m.width, m.height};
    return {};
  }
  ImageInfo info;
  info.format = known->first;
  info.width_px = m.width;
  info.height_px = m.height;
  if (stamped_ && settings_) {
    if (const auto format = pixel_format_from(settings_->pixel_format);
        format && encoding_of(*format) == m.encoding)
      info.format = *format;
    info.offset_x_px = settings_->offset_x_px;
    info.offset_y_px = settings_->offset_y_px;
    info.exposure = Duration(settings_->exposure_ns);
    info.gain_db = settings_->gain_db;
  }
  info_ = info;
  return {};
}

Status SampleDecoder::decode_point_cloud(const MessageView& message) {
  msg::PointCloud2 m;
  if (Status status = CdrReader::read(message.data, m); !status) return status;
  if (!is_own_layout(m)) return decode_other_points(m, message);
  const std::uint64_t count = std::uint64_t{m.width} * m.height;
  if (count > m.data.size() / sizeof(LidarPoint) || count * sizeof(LidarPoint) != m.data.size())
    return fail(ErrorCode::protocol, "", "a point cloud holds another number of points than it states");
  stamp_from(m.header, message);
  info_ = PointCloudInfo{static_cast<std::uint32_t>(count)};
  main_bytes_ = m.data;
  return {};
}

/// Of a recording by Rigor with what the layout leaves out beside it; of another program as its fields say.
Status SampleDecoder::decode_other_points(const msg::PointCloud2& cloud, const MessageView& message) {
  msg::PointCloud2 timing;
  if (stamped_) {
    if (!timing_)
      return fail(ErrorCode::protocol, "",
                  "expected the companion " + topic_ +
                      "/timing of a cloud in another layout than Rigor's own, found none: without it the "
                      "sample cannot be given back as it was");
    if (Status status = CdrReader::read(*timing_, timing); !status) return status;
  }
  if (Status status = unpack_points(cloud, stamped_ ? &timing : nullptr, points_); !status) return status;
  stamp_from(cloud.header, message);
  info_ = PointCloudInfo{static_cast<std::uint32_t>(points_.size())};
  main_bytes_ = std::as_bytes(std::span(points_));
  return {};
}

Status SampleDecoder::decode_imu(const MessageView& message) {
  msg::Imu m;
  if (Status status = CdrReader::read(message.data, m); !status) return status;
  const auto &f = m.linear_acceleration, &w = m.angular_velocity;
  ImuSample imu{{f.x, f.y, f.z}, {w.x, w.y, w.z}};
  if (stamped_ && temperature_) imu.temperature_c = temperature_->temperature;
  stamp_from(m.header, message);
  info_ = imu;
  return {};
}

Status SampleDecoder::decode_nav_fix(const MessageView& message) {
  msg::NavSatFix m;
  if (Status status = CdrReader::read(message.data, m); !status) return status;
  // Without a companion: receivers that reach an RTK solution tell so as GBAS.
  const std::array foreign{FixStatus::none, FixStatus::fix, FixStatus::sbas, FixStatus::rtk_fixed};
  const int place = m.status.status + 1;
  NavFix fix{place >= 0 && place < 4 ? foreign[static_cast<std::size_t>(place)] : FixStatus::none,
             0,
             m.latitude,
             m.longitude,
             m.altitude,
             m.position_covariance};
  if (stamped_ && quality_) {
    if (quality_->status > static_cast<std::uint8_t>(FixStatus::rtk_fixed))
      return fail(ErrorCode::protocol, "",
                  "expected a fix status from 0 to 4, got " + std::to_string(quality_->status));
    fix.status = static_cast<FixStatus>(quality_->status);
    fix.satellites = quality_->satellites;
  }
  stamp_from(m.header, message);
  info_ = fix;
  return {};
}

Status SampleDecoder::decode_odometry(const MessageView& message) {
  msg::Odometry m;
  if (Status status = CdrReader::read(message.data, m); !status) return status;
  const auto& [p, q] = m.pose.pose;
  const auto& [v, w] = m.twist.twist;
  Odometry odometry;
  odometry.T_odom_base = {{p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}};
  odometry.velocity_mps = {v.x, v.y, v.z};
  odometry.turn_rate_radps = {w.x, w.y, w.z};
  for (std::size_t i = 0; i < 6; ++i) {
    odometry.pose_variance[i] = m.pose.covariance[i * 7];
    odometry.twist_variance[i] = m.twist.covariance[i * 7];
  }
  if (stamped_ && wheels_) {
    if (wheels_->position.size() != 2 || wheels_->velocity.size() != 2)
      return fail(ErrorCode::protocol, "",
                  "expected angles and rates of two wheels, left and right, got " +
                      std::to_string(wheels_->position.size()) + " and " +
                      std::to_string(wheels_->velocity.size()));
    std::copy_n(wheels_->position.begin(), 2, odometry.wheel_angle_rad.begin());
    std::copy_n(wheels_->velocity.begin(), 2, odometry.wheel_rate_radps.begin());
  }
  stamp_from(m.header, message);
  info_ = odometry;
  return {};
}

Status SampleDecoder::fill(Sample& sample) const {
  const std::span<std::byte> memory = sample.memory();
  if (size_bytes() > memory.size())
    return fail(ErrorCode::bad_input, topic_,
                "a recorded sample holds " + std::to_string(size_bytes()) +
                    " bytes, the channel has room for " + std::to_string(memory.size()));
  sample.stamp = stamp_;
  sample.info = info_;
  sample.size_bytes = size_bytes();
  if (!main_bytes_.empty()) std::memcpy(memory.data(), main_bytes_.data(), main_bytes_.size());
  if (!second_bytes_.empty())
    std::memcpy(memory.data() + main_bytes_.size(), second_bytes_.data(), second_bytes_.size());
  return {};
}

}  // namespace rigor::record
