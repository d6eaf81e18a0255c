#include "drivers/ouster/imu_stream.h"

#include <numbers>

namespace rigor::ouster {

std::optional<packet_lidar::Reading> ImuStream::take(Bytes datagram, BenchTime arrival) {
  const auto packet = parse_imu(datagram);
  if (!packet) {
    ++malformed_;
    return {};
  }
  constexpr double kG = 9.80665;
  ImuSample imu;
  for (std::size_t i = 0; i < 3; ++i) {
    imu.specific_force_mps2[i] = static_cast<double>(packet->acceleration_g[i]) * kG;
    imu.angular_rate_radps[i] = static_cast<double>(packet->turn_rate_dps[i]) * (std::numbers::pi / 180);
  }
  const DeviceTime t(static_cast<std::int64_t>(packet->accelerometer_ns & 0x3FFF'FFFF'FFFF'FFFF));
  return readings_.take(t, imu, arrival);
}

ImuStream::Counters ImuStream::counters() const {
  const packet_lidar::ReadingStream::Counters& c = readings_.counters();
  return {c.readings, c.lost, c.clock_steps, malformed_ + c.repeated};
}

}  // namespace rigor::ouster
