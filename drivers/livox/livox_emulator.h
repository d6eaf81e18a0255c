// An emulated Livox Mid-360: it answers to searches and commands (lidar_control.h), pushes its state once a
// second, and sends the packets of a simulated LiDAR to where its hosts said. Keys: livox_settings.h.
//
//   command thread    answers, pushes
//   measuring thread  scans, ahead of those that are due (ScanAhead)
//   sending thread    each packet when its last point has fired, absolute; readings of the unit between them
//
// Timestamps are ns since it was switched on, of PTP (TAI, which is UTC and 37 s), or of GPS once a host has
// set them. `connected`: nobody said that nobody listens (ICMP).
#pragma once

#include <mutex>
#include <optional>
#include <thread>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/livox/livox_settings.h"
#include "drivers/livox/mid360_device.h"
#include "drivers/network/udp_sender.h"
#include "rt-core/deadline.h"
#include "rt-core/epoch.h"
#include "rt-core/file_descriptor.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::livox {

class LivoxEmulator final : public Emulator {
 public:
  ~LivoxEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  /// Once armed: where it takes commands, and searches (0: it does not).
  [[nodiscard]] std::uint16_t command_port() const { return command_port_; }
  [[nodiscard]] std::uint16_t search_port() const { return search_port_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  /// Where one kind of its packets goes.
  struct Way {
    network::UdpSender sender;
    HostAddress to;
    bool told = false;  ///< that it cannot be opened
  };
  [[nodiscard]] LidarControl::Active active();
  void serve();
  void answer(int fd, bool searching);
  void run();
  void send_points(const LidarControl::Active& active);
  void send_readings(const LidarControl::Active& active, const DeviceClock& clock, BenchTime t_start,
                     BenchTime until);
  void send(Way& way, const HostAddress& to, Bytes bytes);

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::optional<Mid360Device> device_;
  std::mutex mutex_;  ///< of control_
  std::optional<LidarControl> control_;
  FileDescriptor commands_, searches_;
  std::uint16_t command_port_ = 0, search_port_ = 0;
  std::optional<packet_lidar::ScanAhead> scans_;
  Way points_, readings_, states_;
  EpochPair epoch_{};
  BenchTime t_first_;
  std::uint64_t readings_sent_ = 0;
  Deadline sending_, serving_;
  std::thread sender_, server_;
};

}  // namespace rigor::livox
