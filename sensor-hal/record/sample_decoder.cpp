#include <algorithm>
#include <cstddef>
#include <cstring>

#include "sensor-hal/record/image_encoding.h"
#include "sensor-hal/record/ros2_time.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor::record {
namespace {

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
