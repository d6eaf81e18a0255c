// A Livox in virtual time: the device and its packets in process (mid360_device.h), decoded as they would be
// from the network; points, or its inertial unit at rest. Its first firing is at the run's start, t0; a
// packet is there when its last point has fired. What moves in the world is where it is when a scan begins.
#pragma once

#include <optional>

#include "drivers/lidar/virtual_sensor.h"
#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/livox_settings.h"
#include "drivers/livox/mid360_device.h"

namespace rigor::livox {

class VirtualSource final : public packet_lidar::VirtualSensor {
 public:
  using VirtualSensor::VirtualSensor;

 protected:
  Status do_configure(const ChannelConfig& config) override;

 private:
  Status open_device() override;
  void begin(BenchTime t0) override;
  void send_until(BenchTime now) override { is_imu() ? send_readings(now) : send_points(now); }
  void send_points(BenchTime now);
  void send_readings(BenchTime now);
  [[nodiscard]] const packet_lidar::Scan* scan(std::uint64_t k);

  SourceSettings settings_;
  EmulatorSettings device_settings_;
  std::optional<Mid360Device> device_;
  std::optional<PointStream> points_;
  std::optional<ImuDecoder> imu_;
  std::vector<packet_lidar::Scan> scans_;  ///< the last two, k at k % 2
  std::uint64_t measured_ = 0;             ///< scans
  std::uint64_t packet_ = 0;               ///< or reading, the next
  std::vector<std::uint8_t> bytes_;
  BenchTime t0_;
};

}  // namespace rigor::livox
