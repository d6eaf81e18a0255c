// A Velodyne on the network, or a recording of one, as a channel. Keys: velodyne_settings.h.
//
// Network: a thread takes datagrams in batches with the kernel's stamps. `arm` listens for up to 2 s: which
// model it is, and that it is there at all. A second without a packet, and `connected` falls until the next
// one comes (`reconnects` counts those); an interface that goes away is opened again with growing pauses.
// Packets are read from arm on; clouds of before the run are discarded, and the packets teach the clock map.
//
// Recording: packet_source.h.
#pragma once

#include <memory>

#include "drivers/lidar/packet_source.h"
#include "drivers/velodyne/model_choice.h"

namespace rigor::velodyne {

class VelodyneSource final : public packet_lidar::PacketSource {
 public:
  ~VelodyneSource() override;

  /// Beside health(). Any thread.
  struct Counters : packet_lidar::PacketCounters {
    std::uint64_t position_packets = 0, full_turns = 0;
    PpsStatus pps = PpsStatus::absent;  ///< of the last position packet
  };
  [[nodiscard]] Counters counters() const { return counters_.load(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return settings_.file.empty(); }

 private:
  Status arm_network() override;
  Status arm_file(Feed feed) override;
  void leave_network() override { data_.close(), position_.close(); }
  [[nodiscard]] const char* driver_name() const override { return "velodyne"; }
  void take(Bytes datagram, BenchTime arrival) override;
  void set_epoch(const EpochPair& epoch) override { stream_->clock().set_epoch(epoch); }
  [[nodiscard]] std::uint64_t good_packets() const override { return stream_->counters().packets; }
  void publish() override;

  Status open_clouds_of(std::uint8_t product, const ModelEvidence& evidence, Feed feed);
  void run_network();
  void receive_position(std::span<const network::UdpReceiver::Datagram> batch);

  SourceSettings settings_;
  std::unique_ptr<CloudStream> stream_;
  network::UdpReceiver data_, position_;
  Counters counted_;  ///< of position packets; the others are the stream's
  packet_lidar::Published<Counters> counters_;
};

}  // namespace rigor::velodyne
