#include "drivers/v4l2/v4l2_virtual_source.h"

#include <fmt/format.h>

namespace rigor::v4l2 {

VirtualSource::VirtualSource(DeviceParts parts, ConfigNode emulator_params)
    : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}

Status VirtualSource::do_configure(const ChannelConfig& config) {
  if (auto s = VideoSource::do_configure(config); !s) return s;
  if (config.period.ns() <= 0)
    return fail(ErrorCode::bad_input, config.name,
                "expected a rate: a camera in virtual time captures on the bench's grid");
  camera_ = read_emulated_video(emulator_params_, default_frame_id(config.name), config.period);
  return {};
}

Status VirtualSource::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  auto pictures = EmulatedPictures::create(camera_, parts_, config().name);
  if (!pictures) return tl::unexpected<Error>(pictures.error());
  auto device = std::make_unique<EmulatedCapture>(camera_, std::move(*pictures));
  auto plan = set_up(*device, settings_, config());
  if (!plan) return tl::unexpected<Error>(plan.error());
  const Duration needed = (device->pictures().exposure() + camera_.readout) / 2;
  if (config().latency < needed)
    return fail(
        ErrorCode::bad_input, config().params.error("latency_ms", "").error().where,
        fmt::format("latency_ms: expected at least {:g} ms, half of exposure and readout: earlier no picture "
                    "can be there; got {:g} ms",
                    needed.seconds() * 1e3, config().latency.seconds() * 1e3));
  if (device->pictures().exposure() > config().period)
    return fail(ErrorCode::bad_input, config().params.error("rate_hz", "").error().where,
                fmt::format("rate_hz: expected a period of at least the exposure of {:g} ms, got {:g} ms",
                            device->pictures().exposure().seconds() * 1e3, config().period.seconds() * 1e3));
  open_samples(std::move(*plan), true);
  device_ = std::move(device);
  health_.connected = true;
  return {};
}

Status VirtualSource::do_start(BenchTime t0) {
  device_->set_grid(t0, config().period);
  return device_->start(settings_.queue);
}

Status VirtualSource::do_stop() {
  device_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

void VirtualSource::complete_until(BenchTime now) {
  if (!device_) return;
  RawFrame frame;
  while (device_->advance(now))  // one capture at a time: a long step drops none
    while (device_->next(frame) == FrameStatus::frame) {
      deliver(frame);
      device_->release(frame);
    }
}

}  // namespace rigor::v4l2
