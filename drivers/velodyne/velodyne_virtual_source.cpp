#include "drivers/velodyne/velodyne_virtual_source.h"

namespace rigor::velodyne {

Status VirtualSource::do_configure(const ChannelConfig& config) {
  if (auto s = CloudChannel::do_configure(config); !s) return s;
  settings_.stream.time = TimeSource::fixed;
  device_settings_ = read_emulator_settings(emulator_params_);
  if (settings_.model && *settings_.model != device_settings_.model)
    throw config.params.error("model", "expected the model of the emulator that stands for this device, " +
                                           std::string(facts_of(device_settings_.model).key));
  return {};
}

Status VirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
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
  if (config().latency < least)
    return tl::unexpected<Error>(
        config()
            .params
            .error("latency_ms", "expected at least " + std::to_string(least.seconds() * 1e3) +
                                     ": earlier the last packet cannot be there; got " +
                                     std::to_string(config().latency.seconds() * 1e3))
            .error());
  warnings_.clear();
  if (auto s = open_model(device_settings_.model, Feed::virtual_time); !s) return s;
  if (model_of(device_settings_.product) != device_settings_.model && !settings_.model)
    (void)decide_model(device_settings_.product, ModelEvidence{});
  device_.emplace(std::move(*device));
  revolutions_.clear();
  for (int i = 0; i < 2; ++i) revolutions_.push_back(device_->make_revolution());
  health_.connected = true;
  return {};
}

Status VirtualSource::do_start(BenchTime t0) {
  t0_ = t0;
  stream_->clock().set_fixed_offset(t0 - BenchTime(0));
  next_packet_ = measured_ = 0;
  running_ = true;
  return {};
}

Status VirtualSource::do_stop() {
  running_ = false;
  close_stream();
  device_.reset();
  health_.connected = false;
  return {};
}

void VirtualSource::complete_until(BenchTime now) {
  if (!running_) return;
  const std::int64_t packet_ns = device_->packet_ns();
  while (true) {
    const BenchTime there = t0_ + Duration(static_cast<std::int64_t>(next_packet_ + 1) * packet_ns);
    if (there > now) return;
    for (const std::uint64_t last = device_->last_revolution_of(next_packet_); measured_ <= last;
         ++measured_) {
      const BenchTime begin = t0_ + Duration(device_->begin_ns(measured_));
      const WorldMotion motion = parts_.motion ? parts_.motion->motion_at(begin) : WorldMotion{};
      if (!device_->measure(measured_, begin, motion, revolutions_[measured_ % 2]))
        health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    }
    device_->compose(
        next_packet_,
        [&](std::uint64_t k) {
          const Revolution& r = revolutions_[k % 2];
          return r.seen && r.index == k ? &r : nullptr;
        },
        packet_);
    take(packet_.bytes(), there);
    ++next_packet_;
  }
}

}  // namespace rigor::velodyne
