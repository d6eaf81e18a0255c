// A Velodyne in virtual time: the rotor and its packets in process (rotor_device.h), decoded as they would be
// from the network. The rotor passes azimuth 0 at the run's start, t0, and turns at its sensor model's rate;
// a packet is there when its last laser has fired. What moves in the world is where it is when a revolution
// begins.
#pragma once

#include <memory>
#include <optional>

#include "drivers/lidar/virtual_sensor.h"
#include "drivers/velodyne/model_choice.h"
#include "drivers/velodyne/rotor_device.h"

namespace rigor::velodyne {

class VirtualSource final : public packet_lidar::VirtualSensor {
 public:
  using VirtualSensor::VirtualSensor;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;

 private:
  Status open_device() override;
  void begin(BenchTime t0) override;
  void send_until(BenchTime now) override;

  SourceSettings settings_;
  EmulatorSettings device_settings_;
  std::vector<std::string> warnings_;
  std::optional<RotorDevice> device_;
  std::unique_ptr<CloudStream> stream_;
  std::vector<Revolution> revolutions_;  ///< the one at hand and the next
  std::uint64_t measured_ = 0;           ///< revolutions
  std::uint64_t next_packet_ = 0;
  DataPacketWriter packet_;
  BenchTime t0_;
};

}  // namespace rigor::velodyne
