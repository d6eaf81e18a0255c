#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sensor-hal/record/image_encoding.h"
#include "sensor-hal/record/ros2_time.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor::record {
namespace {

constexpr std::size_t kStamp = 0;
constexpr std::size_t kMain = 1;
constexpr std::size_t kCompanion = 2;

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

}  // namespace rigor::record
