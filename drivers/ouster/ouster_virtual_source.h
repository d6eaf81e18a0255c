// An Ouster in virtual time: the sensor and its packets in process (sensor_device.h), decoded as they would
// be from the network. It is switched on at the run's start, and its first frame begins then, or with phase
// lock as soon as the phase says. A packet is there when its last column has fired. What moves in the world
// is where it is when a frame begins.
#pragma once

#include <optional>

#include "drivers/lidar/virtual_sensor.h"
#include "drivers/ouster/ouster_settings.h"
#include "drivers/ouster/sensor_control.h"

namespace rigor::ouster {

class VirtualSource final : public packet_lidar::VirtualSensor {
 public:
  using VirtualSensor::VirtualSensor;

 protected:
  Status do_configure(const ChannelConfig& config) override;

 private:
  Status open_device() override;
  void begin(BenchTime t0) override;
  void send_until(BenchTime now) override;

  SourceSettings settings_;
  EmulatorSettings device_settings_;
  std::optional<SensorDevice> device_;
  std::optional<FrameStream> stream_;
  std::optional<LidarPacketWriter> packet_;
  std::optional<packet_lidar::Scan> scan_;
  std::uint64_t frame_ = 0;
  std::uint32_t slot_ = 0;
  SensorTime time_;
  BenchTime t_first_;           ///< of frame 0
  std::uint64_t start_ns_ = 0;  ///< the sensor's time there
  bool measured_ = false;
};

}  // namespace rigor::ouster
