// A Velodyne in virtual time: the rotor and its packets in process (rotor_device.h), decoded as they would be
// from the network. The rotor passes azimuth 0 at the run's start, t0, and turns at its sensor model's rate;
// a packet is there when its last laser has fired. What moves in the world is where it is when a revolution
// begins.
#pragma once

#include <deque>
#include <optional>

#include "drivers/velodyne/cloud_channel.h"
#include "drivers/velodyne/rotor_device.h"

namespace rigor::velodyne {

class VirtualSource final : public CloudChannel {
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
  DeviceParts parts_;
  ConfigNode emulator_params_;
  EmulatorSettings device_settings_;
  std::optional<RotorDevice> device_;
  std::vector<Revolution> revolutions_;  ///< the one at hand and the next
  std::uint64_t measured_ = 0;           ///< revolutions
  std::uint64_t next_packet_ = 0;
  DataPacketWriter packet_;
  BenchTime t0_;
  bool running_ = false;
};

}  // namespace rigor::velodyne
