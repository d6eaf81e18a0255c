#include "drivers/livox/imu_decoder.h"

#include <cmath>

#include "drivers/livox/point_stream.h"

namespace rigor::livox {
namespace {

constexpr double kG = 9.80665;

}  // namespace

std::optional<packet_lidar::Reading> ImuDecoder::take(Bytes datagram, BenchTime arrival) {
  PacketFault fault{};
  const auto packet = Packet::parse(datagram, fault);
  if (!packet || packet->data_type() != DataType::imu) {
    ++malformed_;
    return {};
  }
  const ImuReading r = packet->imu();
  ImuSample imu;
  for (std::size_t i = 0; i < 3; ++i) {
    imu.specific_force_mps2[i] = static_cast<double>(r.acceleration_g[i]) * kG;
    imu.angular_rate_radps[i] = static_cast<double>(r.turn_rate_radps[i]);
    if (!std::isfinite(imu.specific_force_mps2[i]) || !std::isfinite(imu.angular_rate_radps[i])) {
      ++malformed_;
      return {};
    }
  }
  const bool utc = time_ == packet_lidar::TimeSource::utc;
  if (utc) stream_.clock().set_utc_offset(utc_offset_.value_or(utc_less(packet->time_type())));
  auto reading = stream_.take(
      DeviceTime(static_cast<std::int64_t>(packet->timestamp_ns() & 0x3FFF'FFFF'FFFF'FFFF)), imu, arrival);
  if (reading && utc && packet->time_type() == TimeType::none) reading->validity |= kClockUnsure;
  return reading;
}

}  // namespace rigor::livox
