#include "drivers/livox/livox_virtual_source.h"

namespace rigor::livox {

Status VirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  settings_.stream.time = packet_lidar::TimeSource::fixed;
  device_settings_ = read_emulator_settings(emulator_params_);
  if (settings_.data_type) device_settings_.setup.data_type = *settings_.data_type;
  description_.kind = config.kind;
  description_.frame_id = settings_.frame_id;
  return {};
}

Status VirtualSource::do_arm(const ArmContext& context) {
  const std::string& name = config().name;
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, name, "this stand-in runs in virtual time only");
  auto device = Mid360Device::create(parts_.samples);
  if (!device) return fail(device.error().code, name, device.error().text());
  device_.emplace(std::move(*device));
  // A channel with `host` tells the device to measure; any other takes it as it is.
  if (settings_.host.empty() && device_settings_.setup.target != WorkState::sampling)
    return fail(ErrorCode::bad_input, name,
                "expected a device that measures, got one in mode " +
                    std::string(name_of(device_settings_.setup.target)) + "; with `host` it is told to");
  health_.connected = true;
  if (is_imu()) {
    imu_.emplace(
        packet_lidar::ReadingStream::Options{packet_lidar::TimeSource::fixed, Duration(kImuPeriod_ns)},
        std::nullopt);
    open_readings(settings_.buffers, Feed::virtual_time);
    return {};
  }
  // Half a packet of the next frame may come with its last point.
  const Duration least = settings_.stream.frame + Duration(kPoint_ns * kDots);
  if (config().latency < least)
    return tl::unexpected<Error>(
        config()
            .params
            .error("latency_ms", "expected at least " + std::to_string(least.seconds() * 1e3) +
                                     ": earlier the last packet cannot be there; got " +
                                     std::to_string(config().latency.seconds() * 1e3))
            .error());
  points_.emplace(settings_.stream);
  scans_.assign(2, device_->make_scan());
  open_clouds(settings_.buffers, points_->max_points(), Feed::virtual_time);
  return {};
}

Status VirtualSource::do_start(BenchTime t0) {
  t0_ = t0;
  if (points_) points_->clock().set_fixed_offset(t0 - BenchTime(0));
  if (imu_) imu_->clock().set_fixed_offset(t0 - BenchTime(0));
  measured_ = packet_ = 0;
  running_ = true;
  return {};
}

Status VirtualSource::do_stop() {
  running_ = false;
  points_.reset();
  imu_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

const packet_lidar::Scan* VirtualSource::scan(std::uint64_t k) {
  for (; measured_ <= k; ++measured_) {
    const BenchTime begin = t0_ + device_->begin(measured_);
    const WorldMotion motion = parts_.motion ? parts_.motion->motion_at(begin) : WorldMotion{};
    if (!device_->measure(measured_, begin, motion, scans_[measured_ % 2]))
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  }
  return &scans_[k % 2];
}

void VirtualSource::send_points(BenchTime now) {
  while (true) {
    const BenchTime there = t0_ + Mid360Device::filled(packet_);
    if (there > now) return;
    device_->compose(
        packet_, device_settings_.setup.data_type, {}, [this](std::uint64_t k) { return scan(k); }, bytes_);
    points_->take(bytes_, there, hand());
    count_malformed(points_->counters().malformed);
    ++packet_;
  }
}

void VirtualSource::send_readings(BenchTime now) {
  while (true) {
    const std::int64_t since_ns = static_cast<std::int64_t>(packet_) * kImuPeriod_ns;
    const BenchTime there = t0_ + Duration(since_ns);
    if (there > now) return;
    PacketHead head;
    head.udp_count = static_cast<std::uint16_t>(packet_);
    head.timestamp_ns = static_cast<std::uint64_t>(since_ns);
    if (const auto reading = imu_->take(compose_imu(head, at_rest()), there)) hand_reading(*reading);
    count_malformed(imu_->malformed());
    ++packet_;
  }
}

void VirtualSource::complete_until(BenchTime now) {
  if (!running_) return;
  is_imu() ? send_readings(now) : send_points(now);
}

}  // namespace rigor::livox
