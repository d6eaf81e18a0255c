// A packet LiDAR on the network, or a recording of one, as a channel: which datagrams are the device's,
// whether it is there, and how a recording is played.
//
// Network: a second without a packet, and `connected` falls until the next one comes (`reconnects` counts
// those). Recording: packets come at the distances that their stamps have, from the run's start on; in
// virtual time exactly so. At its end `connected` falls.
//
//   class LivoxSource final : public packet_lidar::PacketSource { … };
//   arm_network   opens sockets and waits for packets; its thread gives batches to receive() and calls
//                 watch_silence() at least ten times a second
//   arm_file      calls open_recording()
//   take          decodes a datagram; publish writes the counters after a batch of them
#pragma once

#include <mutex>
#include <optional>
#include <thread>

#include "drivers/lidar/sensor_source.h"
#include "drivers/network/pcap_feed.h"
#include "drivers/network/udp_receiver.h"
#include "rt-core/deadline.h"

namespace rigor::packet_lidar {

using Bytes = std::span<const std::uint8_t>;

/// What was lost of the packets of a device, and where. Beside a channel's health().
struct PacketCounters {
  std::uint64_t packets = 0;       ///< good ones of the channel's kind
  std::uint64_t packets_lost = 0;  ///< by the device's numbers or times
  std::uint64_t clock_steps = 0;   ///< of the device's clock
  std::uint64_t kernel_drops = 0;  ///< datagrams for which the socket's buffer had no room
  std::uint64_t foreign = 0;       ///< datagrams of other senders than the device
};

/// Counters that one thread writes and any thread reads.
template <class Counters>
class Published {
 public:
  void store(const Counters& c) {
    const std::lock_guard lock(mutex_);
    counters_ = c;
  }
  [[nodiscard]] Counters load() const {
    const std::lock_guard lock(mutex_);
    return counters_;
  }

 private:
  mutable std::mutex mutex_;
  Counters counters_;
};

class PacketSource : public SensorSource {
 public:
  void complete_until(BenchTime now) final;
  [[nodiscard]] std::vector<std::string> warnings() const final { return warnings_; }

 protected:
  Status do_arm(const ArmContext& context) final;
  Status do_start(BenchTime t0) final;
  Status do_stop() final;

  // The driver's, at setup.
  virtual Status arm_network() = 0;
  virtual Status arm_file(Feed feed) = 0;
  /// Closes its sockets and joins the threads that use them; also where arm_network failed.
  virtual void leave_network() = 0;
  /// The driver's name for threads: at most 10 characters.
  [[nodiscard]] virtual const char* driver_name() const = 0;
  // The driver's, in the thread that receives or plays.
  virtual void take(Bytes datagram, BenchTime arrival) = 0;
  /// How UTC and bench time hang together now, for the clock of the driver's stream.
  virtual void set_epoch(const EpochPair& epoch) = 0;
  /// Good packets so far.
  [[nodiscard]] virtual std::uint64_t good_packets() const = 0;
  virtual void publish() = 0;
  /// Packets come again after a silence.
  virtual void on_return() {}
  /// A recording has ended: what is at hand is handed on.
  virtual void on_end_of_recording() {}

  /// In arm_file. The datagrams of a recording that are `wanted`.
  [[nodiscard]] Status open_recording(const std::filesystem::path& file, network::PcapFeed::Wanted wanted);
  /// In arm_network: packets are there.
  void begin_listening();
  void warn_of_small_buffer(std::int64_t granted_bytes, std::int64_t asked_bytes);
  /// I/O thread.
  void receive(std::span<const network::UdpReceiver::Datagram> batch);
  /// I/O thread. True while the device is silent.
  bool watch_silence();
  /// I/O thread: whether nobody sends here.
  [[nodiscard]] bool hears_nobody() const;
  [[nodiscard]] std::uint64_t foreign() const { return foreign_; }

  std::vector<std::string> warnings_;
  std::uint32_t device_ipv4_ = 0;  ///< in host order; 0: any sender is the device
  Deadline deadline_;              ///< cut by stop
  std::thread thread_;

 private:
  void end_of_recording();

  std::optional<network::PcapFeed> feed_;
  BenchTime t0_, t_last_packet_, t_last_datagram_;  ///< datagram: of anyone
  std::uint64_t foreign_ = 0;
};

}  // namespace rigor::packet_lidar
