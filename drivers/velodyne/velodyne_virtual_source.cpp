#include "drivers/velodyne/velodyne_virtual_source.h"

namespace rigor::velodyne {

Status VirtualSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  describe_clouds(settings_, description_);
  settings_.stream.time = TimeSource::fixed;
  device_settings_ = read_emulator_settings(emulator_params_);
  if (settings_.model && *settings_.model != device_settings_.model)
    throw config.params.error("model", "expected the model of the emulator that stands for this device, " +
                                           std::string(facts_of(device_settings_.model).key));
  return {};
}

Status VirtualSource::open_device() {
  RotorSettings rotor;
  rotor.model = device_settings_.model;
  rotor.dual = device_settings_.returns == ReturnMode::dual;
  rotor.single = rotor.dual ? ReturnMode::strongest : device_settings_.returns;
  rotor.product = device_settings_.product;
  auto device = RotorDevice::create(rotor, parts_.samples);
  if (!device) return fail(device.error().code, config().name, device.error().text());
  const Duration filled(device->packet_ns());
  const Duration least =
      settings_.stream.unit == CloudUnit::packet ? filled : device->revolution_time() + filled * 2;
  if (auto s = check_latency(least); !s) return s;
  warnings_.clear();
  auto stream = open_model(settings_, device_settings_.model);
  if (!stream) return tl::unexpected<Error>(stream.error());
  stream_ = std::move(*stream);
  open_clouds(settings_.buffers, settings_.stream.max_points, Feed::virtual_time);
  if (model_of(device_settings_.product) != device_settings_.model && !settings_.model)
    (void)decide_model(settings_, device_settings_.product, ModelEvidence{}, warnings_);
  device_.emplace(std::move(*device));
  revolutions_.clear();
  for (int i = 0; i < 2; ++i) revolutions_.push_back(device_->make_revolution());
  return {};
}

void VirtualSource::begin(BenchTime t0) {
  t0_ = t0;
  stream_->clock().set_fixed_offset(t0 - BenchTime(0));
  next_packet_ = measured_ = 0;
}

void VirtualSource::send_until(BenchTime now) {
  const std::int64_t packet_ns = device_->packet_ns();
  while (true) {
    const BenchTime there = t0_ + Duration(static_cast<std::int64_t>(next_packet_ + 1) * packet_ns);
    if (there > now) return;
    for (const std::uint64_t last = device_->last_revolution_of(next_packet_); measured_ <= last; ++measured_)
      measure(*device_, measured_, t0_ + Duration(device_->begin_ns(measured_)), revolutions_[measured_ % 2]);
    device_->compose(
        next_packet_,
        [&](std::uint64_t k) {
          const Revolution& r = revolutions_[k % 2];
          return r.seen && r.index == k ? &r : nullptr;
        },
        packet_);
    stream_->take(packet_.bytes(), there, hand());
    count_malformed(stream_->counters().malformed);
    ++next_packet_;
  }
}

}  // namespace rigor::velodyne
