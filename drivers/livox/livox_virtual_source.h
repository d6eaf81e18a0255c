// A Livox in virtual time: the device and its packets in process (mid360_device.h), decoded as they would be
// from the network; points, or its inertial unit at rest. Its first firing is at the run's start, t0; a
// packet is there when its last point has fired. What moves in the world is where it is when a scan begins.
#pragma once

#include <optional>

#include "drivers/lidar/sensor_source.h"
#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/livox_settings.h"
#include "drivers/livox/mid360_device.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::livox {

class VirtualSource final : public packet_lidar::SensorSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  VirtualSource(DeviceParts parts, ConfigNode emulator_params)
      : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void send_points(BenchTime now);
  void send_readings(BenchTime now);
  [[nodiscard]] const packet_lidar::Scan* scan(std::uint64_t k);

  DeviceParts parts_;
  ConfigNode emulator_params_;
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
  bool running_ = false;
};

}  // namespace rigor::livox
