// A Livox Mid-360 on the network, or a recording of one, as a channel of points or of its inertial unit.
// Keys: livox_settings.h.
//
// Network: with `host`, `arm` tells the device to measure and to send to this machine, waits until it is
// SAMPLING, and then listens for up to 2 s for its packets; without, it listens alone. A second without a
// packet, and `connected` falls until the next one comes (`reconnects` counts those); meanwhile a device
// with `host` is told again, as one that was switched off and on may have forgotten.
//
// Recording: packet_source.h.
#pragma once

#include <optional>

#include "drivers/lidar/packet_source.h"
#include "drivers/livox/command_client.h"
#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/livox_settings.h"
#include "drivers/network/udp_ports.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::livox {

class LivoxSource final : public packet_lidar::PacketSource {
 public:
  ~LivoxSource() override;

  /// Beside health(). Any thread.
  struct Counters : packet_lidar::PacketCounters {
    std::uint64_t packets_late = 0, told_again = 0;
  };
  [[nodiscard]] Counters counters() const { return counters_.load(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return settings_.file.empty(); }

 private:
  Status arm_network() override;
  Status arm_file(Feed feed) override;
  void leave_network() override;
  [[nodiscard]] const char* driver_name() const override { return "livox"; }
  void take(Bytes datagram, BenchTime arrival) override;
  void set_epoch(const EpochPair& epoch) override;
  [[nodiscard]] std::uint64_t good_packets() const override;
  void publish() override;
  void on_return() override { again_.reset(); }

  Status tell_device(MonotonicTime deadline);
  Status wait_until_sampling();
  void open_samples(Feed feed);
  [[nodiscard]] bool is_wanted(Bytes datagram) const;
  void run_network();
  void look_after();

  SourceSettings settings_;
  std::optional<PointStream> points_;
  std::optional<ImuDecoder> imu_;
  CommandClient client_;
  network::UdpReceiver receiver_;
  Backoff again_;
  std::uint64_t told_again_ = 0;
  packet_lidar::Published<Counters> counters_;
};

}  // namespace rigor::livox
