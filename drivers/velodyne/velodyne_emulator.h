// A simulated LiDAR leaves the bench as a Velodyne: data and position packets over UDP, at the device's
// instants. Keys: velodyne_settings.h.
//
//   measuring thread  a revolution ahead of the rotor, so that its packets can leave when they are due
//   sending thread    packet j at start + (j + 1) · 1327.104 µs, absolute (dual: half of it)
//
// The device's time is UTC of this machine, as of one with a GPS receiver. The world is measured where it
// will be when the revolution begins, by its motion now. A revolution that is not measured in time is not
// sent; its packets count as lost. `connected`: nobody said that nobody listens (ICMP).
#pragma once

#include <optional>
#include <thread>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/network/udp_sender.h"
#include "drivers/velodyne/rotor_device.h"
#include "drivers/velodyne/velodyne_settings.h"
#include "rt-core/deadline.h"

namespace rigor::velodyne {

class VelodyneEmulator final : public Emulator {
 public:
  ~VelodyneEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  [[nodiscard]] RotorSettings rotor_settings() const;
  void send_packets();
  void send(Bytes bytes, std::uint16_t port);
  void send_position(BenchTime t);

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::optional<RotorDevice> device_;
  std::optional<packet_lidar::ScanAhead> scans_;
  network::UdpSender sender_;
  BenchTime t_start_;
  EpochPair epoch_{};
  Deadline sending_;
  std::thread sending_thread_;
};

}  // namespace rigor::velodyne
