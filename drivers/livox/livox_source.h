// A Livox Mid-360 on the network, or a recording of one, as a channel of points or of its inertial unit.
// Keys: livox_settings.h.
//
// Network: with `host`, `arm` tells the device to measure and to send to this machine, waits until it is
// SAMPLING, and then listens for up to 2 s for its packets; without, it listens alone. A second without a
// packet, and `connected` falls until the next one comes (`reconnects` counts those); meanwhile a device
// with `host` is told again, as one that was switched off and on may have forgotten.
//
// Recording: packets come at the distances that their stamps have, from the run's start on; in virtual time
// exactly so. At its end `connected` falls.
#pragma once

#include <atomic>
#include <optional>
#include <thread>

#include "drivers/lidar/sensor_source.h"
#include "drivers/livox/command_client.h"
#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/livox_settings.h"
#include "drivers/network/pcap_feed.h"
#include "drivers/network/udp_ports.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::livox {

class LivoxSource final : public packet_lidar::SensorSource {
 public:
  ~LivoxSource() override;
  void complete_until(BenchTime now) override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

  /// Beside health(). Any thread.
  struct Counters {
    std::uint64_t packets = 0, packets_lost = 0, packets_late = 0, clock_steps = 0, kernel_drops = 0,
                  foreign = 0, told_again = 0;
  };
  [[nodiscard]] Counters counters() const noexcept;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return settings_.file.empty(); }
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  Status arm_network();
  Status arm_file(bool virtual_time);
  Status tell_device(MonotonicTime deadline);
  Status wait_until_sampling();
  void open_samples(Feed feed);
  [[nodiscard]] bool is_wanted(Bytes datagram) const;
  void run_network();
  void run_file();
  void take(Bytes datagram, BenchTime arrival);
  void receive(std::span<const network::UdpReceiver::Datagram> batch);
  void look_after();
  void end_of_file();
  void publish();
  [[nodiscard]] std::uint64_t good_packets() const;

  SourceSettings settings_;
  std::vector<std::string> warnings_;
  std::optional<PointStream> points_;
  std::optional<ImuDecoder> imu_;
  CommandClient client_;
  std::uint32_t device_ipv4_ = 0;
  network::UdpReceiver receiver_;
  std::optional<network::PcapFeed> feed_;
  BenchTime t0_, t_last_packet_;
  Deadline deadline_;
  Backoff again_;
  std::thread thread_;
  std::atomic<std::uint64_t> packets_{0}, packets_lost_{0}, packets_late_{0}, clock_steps_{0},
      kernel_drops_{0}, foreign_{0}, told_again_{0};
};

}  // namespace rigor::livox
