// A Velodyne on the network, or a recording of one, as a channel. Keys: velodyne_settings.h.
//
// Network: a thread takes datagrams in batches with the kernel's stamps. `arm` listens for up to 2 s: which
// model it is, and that it is there at all. A second without a packet, and `connected` falls until the next
// one comes (`reconnects` counts those); an interface that goes away is opened again with growing pauses.
// Packets are read from arm on; clouds of before the run are discarded, and the packets teach the clock map.
//
// Recording: packets come at the distances that their stamps have, from the run's start on; in virtual time
// exactly so, by the wall clock as well as this machine wakes. At its end `connected` falls.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <thread>

#include "drivers/network/pcap_feed.h"
#include "drivers/network/udp_ports.h"
#include "drivers/velodyne/cloud_channel.h"
#include "rt-core/deadline.h"

namespace rigor::velodyne {

class VelodyneSource final : public CloudChannel {
 public:
  ~VelodyneSource() override;
  void complete_until(BenchTime now) override;

  /// Beside health(). Any thread.
  struct Counters {
    std::uint64_t packets = 0, packets_lost = 0, kernel_drops = 0, foreign = 0, position_packets = 0,
                  clock_steps = 0, full_turns = 0;
    PpsStatus pps = PpsStatus::absent;  ///< of the last position packet
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
  void run_network();
  void run_file();
  void receive_data(std::span<const network::UdpReceiver::Datagram> batch);
  void receive_position(std::span<const network::UdpReceiver::Datagram> batch);
  void end_of_file();
  void publish();

  std::uint32_t from_ipv4_ = 0;
  network::UdpReceiver data_, position_;
  std::optional<network::PcapFeed> feed_;
  BenchTime t0_;
  Deadline deadline_;
  std::thread thread_;
  BenchTime t_last_packet_;
  std::atomic<std::uint64_t> packets_{0}, packets_lost_{0}, kernel_drops_{0}, foreign_{0}, positions_{0},
      clock_steps_{0}, full_turns_{0};
  std::atomic<std::uint8_t> pps_{0};
};

}  // namespace rigor::velodyne
