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

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "drivers/velodyne/pcap_file.h"
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
  static constexpr std::uint64_t kAhead = 2;  ///< revolutions that are measured before they are sent
  static constexpr std::size_t kKept = 16;  ///< more, so that a slow measurement may be of one further ahead
  /// The first revolution that can be measured in time.
  [[nodiscard]] std::uint64_t next_revolution() const;
  void measure_ahead();
  void send_packets();
  void send(Bytes bytes, std::uint16_t port);
  void send_position(BenchTime t);

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::optional<RotorDevice> device_;
  std::optional<PcapWriter> pcap_;
  int socket_ = -1;
  std::uint32_t local_ipv4_ = 0, destination_ipv4_ = 0;
  std::uint16_t local_port_ = 0;
  BenchTime t_start_;
  EpochPair epoch_{};
  Deadline sending_;

  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Revolution> revolutions_;  ///< k at k % kKept
  std::uint64_t measured_ = 0;           ///< revolutions below this one are done or given up
  std::uint64_t sending_revolution_ = 0;
  Duration measuring_time_;  ///< what one revolution takes
  bool stop_ = false;
  std::thread measuring_thread_, sending_thread_;
};

}  // namespace rigor::velodyne
