// An Ouster on the network, or a recording of one, as a channel of points, of images or of its IMU. Keys:
// ouster_settings.h.
//
// Network: `arm` configures the sensor where that is asked for, waits until it is RUNNING, fetches its
// metadata, and listens for up to 2 s for its packets. Channels at one port share it and the thread that
// takes its datagrams, in batches with the kernel's stamps (sensor_port.h). A second without a packet, and
// `connected` falls until the next one comes (`reconnects` counts those). A sensor that was configured anew
// meanwhile has other metadata: they are fetched again, also where nothing comes any more, as it may send to
// another port. Where its frames no longer fit into the channel's samples, the channel stays disconnected.
//
// Recording: packets come at the distances that their stamps have, from the run's start on; in virtual time
// exactly so. At its end `connected` falls.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <thread>

#include "drivers/lidar/sensor_source.h"
#include "drivers/network/pcap_feed.h"
#include "drivers/ouster/imu_stream.h"
#include "drivers/ouster/ouster_settings.h"
#include "drivers/ouster/sensor_client.h"
#include "drivers/ouster/sensor_port.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::ouster {

class OusterSource final : public packet_lidar::SensorSource, private PortClient {
 public:
  ~OusterSource() override;
  void complete_until(BenchTime now) override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

  /// Beside health(). Any thread.
  struct Counters {
    std::uint64_t packets = 0, packets_lost = 0, columns_lost = 0, frames_lost = 0, packets_late = 0,
                  clock_steps = 0, kernel_drops = 0, foreign = 0, reinitialized = 0;
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
  /// Waits until packets of the sensor come. `errors`: protocol errors before.
  Status await_packets(std::size_t expected_bytes, std::uint16_t port, std::uint64_t errors);
  void leave_port();
  Status arm_file(bool virtual_time);
  /// Memory and decoder for a sensor like this.
  Status open_frames(const Metadata& metadata, Feed feed);
  [[nodiscard]] std::uint16_t port_of(const Metadata& metadata) const;
  [[nodiscard]] SensorAddress sensor() const;
  void run_file();
  // Thread of the port.
  void on_epoch(const EpochPair& epoch) override;
  void on_packets(std::span<const network::UdpReceiver::Datagram> batch) override;
  void on_turn(SensorPort& port) override;
  void take(Bytes datagram, BenchTime arrival);
  void end_of_file();
  void publish();
  [[nodiscard]] std::uint64_t good_packets() const;

  SourceSettings settings_;
  std::vector<std::string> warnings_;
  std::optional<FrameStream> frames_;
  std::optional<ImuStream> imu_;
  std::uint32_t sensor_ipv4_ = 0;
  std::shared_ptr<SensorPort> port_;
  std::optional<network::PcapFeed> feed_;
  BenchTime t0_, t_last_packet_, t_last_datagram_;  ///< datagram: of anyone
  std::uint32_t initialization_id_ = 0;
  Deadline deadline_;
  Backoff fetch_;
  std::uint64_t other_seen_ = 0, malformed_seen_ = 0;
  std::thread thread_;
  std::atomic<std::uint64_t> packets_{0}, packets_lost_{0}, columns_lost_{0}, frames_lost_{0},
      packets_late_{0}, clock_steps_{0}, kernel_drops_{0}, foreign_{0}, reinitialized_{0};
};

}  // namespace rigor::ouster
