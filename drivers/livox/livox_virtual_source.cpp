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

Status VirtualSource::open_device() {
  const std::string& name = config().name;
  auto device = Mid360Device::create(parts_.samples);
  if (!device) return fail(device.error().code, name, device.error().text());
  device_.emplace(std::move(*device));
  // A channel with `host` tells the device to measure; any other takes it as it is.
  if (settings_.host.empty() && device_settings_.setup.target != WorkState::sampling)
    return fail(ErrorCode::bad_input, name,
                "expected a device that measures, got one in mode " +
                    std::string(name_of(device_settings_.setup.target)) + "; with `host` it is told to");
  if (is_imu()) {
    imu_.emplace(
        packet_lidar::ReadingStream::Options{packet_lidar::TimeSource::fixed, Duration(kImuPeriod_ns)},
        std::nullopt);
    open_readings(settings_.buffers, Feed::virtual_time);
    return {};
  }
  // Half a packet of the next frame may come with its last point.
  if (auto s = check_latency(settings_.stream.frame + Duration(kPoint_ns * kDots)); !s) return s;
  points_.emplace(settings_.stream);
  scans_.assign(2, device_->make_scan());
  open_clouds(settings_.buffers, points_->max_points(), Feed::virtual_time);
  return {};
}

void VirtualSource::begin(BenchTime t0) {
  t0_ = t0;
  if (points_) points_->clock().set_fixed_offset(t0 - BenchTime(0));
  if (imu_) imu_->clock().set_fixed_offset(t0 - BenchTime(0));
  measured_ = packet_ = 0;
}

const packet_lidar::Scan* VirtualSource::scan(std::uint64_t k) {
  for (; measured_ <= k; ++measured_)
    measure(*device_, measured_, t0_ + device_->begin(measured_), scans_[measured_ % 2]);
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

}  // namespace rigor::livox
