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
// Recording: packet_source.h.
#pragma once

#include <memory>
#include <optional>

#include "drivers/lidar/packet_source.h"
#include "drivers/ouster/imu_stream.h"
#include "drivers/ouster/ouster_settings.h"
#include "drivers/ouster/sensor_client.h"
#include "drivers/ouster/sensor_port.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::ouster {

class OusterSource final : public packet_lidar::PacketSource, private PortClient {
 public:
  ~OusterSource() override;

  /// Beside health(). Any thread.
  struct Counters : packet_lidar::PacketCounters {
    std::uint64_t columns_lost = 0, frames_lost = 0, packets_late = 0, reinitialized = 0;
  };
  [[nodiscard]] Counters counters() const { return counters_.load(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return settings_.file.empty(); }

 private:
  Status arm_network() override;
  Status arm_file(Feed feed) override;
  void leave_network() override;
  [[nodiscard]] const char* driver_name() const override { return "ouster"; }
  void take(Bytes datagram, BenchTime arrival) override;
  void set_epoch(const EpochPair& epoch) override;
  [[nodiscard]] std::uint64_t good_packets() const override;
  void publish() override;
  void on_return() override { fetch_.reset(); }
  void on_end_of_recording() override {
    if (frames_) frames_->finish(hand());
  }

  /// Waits until packets of the sensor come. `errors`: protocol errors before.
  Status await_packets(std::size_t expected_bytes, std::uint16_t port, std::uint64_t errors);
  /// Memory and decoder for a sensor like this.
  Status open_frames(const Metadata& metadata, Feed feed);
  [[nodiscard]] std::uint16_t port_of(const Metadata& metadata) const;
  [[nodiscard]] SensorAddress sensor() const;
  // Thread of the port.
  void on_epoch(const EpochPair& epoch) override { set_epoch(epoch); }
  void on_packets(std::span<const network::UdpReceiver::Datagram> batch) override { receive(batch); }
  void on_turn(SensorPort& port) override;

  SourceSettings settings_;
  std::optional<FrameStream> frames_;
  std::optional<ImuStream> imu_;
  std::shared_ptr<SensorPort> port_;
  std::uint32_t initialization_id_ = 0;
  Backoff fetch_;
  std::uint64_t other_seen_ = 0, malformed_seen_ = 0, kernel_drops_ = 0, reinitialized_ = 0;
  packet_lidar::Published<Counters> counters_;
};

}  // namespace rigor::ouster
