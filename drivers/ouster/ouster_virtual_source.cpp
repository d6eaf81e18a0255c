#include "drivers/ouster/ouster_virtual_source.h"

#include "rt-core/epoch.h"

namespace rigor::ouster {

Status VirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  if (config.kind == SampleKind::imu)
    throw config.params.error("kind",
                              "expected point_cloud, image or range_image: in virtual time the emulated "
                              "sensor has no inertial unit");
  settings_.stream.time = packet_lidar::TimeSource::fixed;
  device_settings_ = read_emulator_settings(emulator_params_);
  description_.kind = config.kind;
  description_.frame_id = settings_.frame_id;
  return {};
}

Status VirtualSource::open_device() {
  const std::string& name = config().name;
  auto device = SensorDevice::create(parts_.samples);
  if (!device) return fail(device.error().code, name, device.error().text());
  device_.emplace(std::move(*device));
  auto control = SensorControl::create(
      *device_, {device_settings_.product, device_settings_.serial, device_settings_.firmware, Duration(0)},
      device_settings_.config, MonotonicTime(0));
  if (!control) return fail(control.error().code, name, control.error().text());
  if (control->active().standby)
    return fail(ErrorCode::bad_input, name, "expected a sensor that measures, got operating_mode STANDBY");
  const Metadata& m = control->active().metadata;
  if (auto s = check_latency(device_->filled(0, m.slots() - 1, m)); !s) return s;
  if (settings_.stream.image)
    if (auto s = check_field(m.profile, settings_.stream.image->field); !s)
      return tl::unexpected<Error>(config().params.error("field", s.error().message).error());
  time_ = control->active().time;
  stream_.emplace(m, settings_.stream);
  packet_.emplace(layout_of(m));
  scan_.emplace(device_->make_scan());
  if (const FrameImage* image = stream_->image())
    open_images(settings_.buffers, image->info(), image->bytes().size(), Feed::virtual_time);
  else
    open_clouds(settings_.buffers, FrameStream::max_points(m), Feed::virtual_time);
  return {};
}

void VirtualSource::begin(BenchTime t0) {
  const RealtimeTime on = kVirtualEpoch.to_utc(t0);
  const RealtimeTime first = time_.first_frame(on, device_->frame_time());
  t_first_ = kVirtualEpoch.to_bench(first);
  start_ns_ = time_.count_at(first, on);
  stream_->clock().set_fixed_offset(Duration(t_first_.ns() - static_cast<std::int64_t>(start_ns_)));
  frame_ = 0;
  slot_ = 0;
  measured_ = false;
}

void VirtualSource::send_until(BenchTime now) {
  const Metadata& m = stream_->metadata();
  while (true) {
    const BenchTime there = t_first_ + device_->filled(frame_, slot_, m);
    if (there > now) return;
    if (!std::exchange(measured_, true)) measure(*device_, frame_, t_first_ + device_->begin(frame_), *scan_);
    device_->compose(frame_, slot_, &*scan_, m, start_ns_, *packet_);
    stream_->take(packet_->bytes(), there, hand());
    count_malformed(stream_->counters().malformed);
    if (++slot_ == m.slots()) {
      slot_ = 0;
      ++frame_;
      measured_ = false;
    }
  }
}

}  // namespace rigor::ouster
