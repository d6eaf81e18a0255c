#include "drivers/lidar/virtual_sensor.h"

namespace rigor::packet_lidar {

Status VirtualSensor::do_arm(const ArmContext& context) {
  if (!context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name, "this stand-in runs in virtual time only");
  if (auto s = open_device(); !s) return s;
  health_.connected = true;
  return {};
}

Status VirtualSensor::do_start(BenchTime t0) {
  begin(t0);
  running_ = true;
  return {};
}

Status VirtualSensor::do_stop() {
  running_ = false;
  close_stream();
  health_.connected = false;
  return {};
}

Status VirtualSensor::check_latency(Duration least) const {
  if (config().latency >= least) return {};
  const auto ms = [](Duration d) { return std::to_string(d.seconds() * 1e3); };
  return tl::unexpected<Error>(
      config()
          .params
          .error("latency_ms", "expected at least " + ms(least) +
                                   ": earlier the last packet cannot be there; got " + ms(config().latency))
          .error());
}

}  // namespace rigor::packet_lidar
