// A UDP port for all channels of a process that take a sensor's packets there: points, and images of the same
// packets. One thread receives each packet once and gives it to every channel.
//
//   auto port = SensorPort::join("0.0.0.0", 7502, buffer_bytes, client);   // arm: the first one opens it
//   port->leave(client);                                                   // stop: the last one closes it
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "drivers/network/udp_ports.h"

namespace rigor::ouster {

class SensorPort;

class PortClient {
 public:
  virtual ~PortClient() = default;
  // I/O thread of the port. The first call of on_epoch comes from join.
  virtual void on_epoch(const EpochPair& epoch) = 0;
  virtual void on_packets(std::span<const network::UdpReceiver::Datagram> batch) = 0;
  /// At least ten times a second.
  virtual void on_turn(SensorPort& port) = 0;
};

class SensorPort {
 public:
  /// Setup thread. The buffer is that of the channel that opens the port. unavailable: another program has
  /// it, or the address is not this machine's.
  [[nodiscard]] static Result<std::shared_ptr<SensorPort>> join(const std::string& address,
                                                                std::uint16_t port, std::int64_t buffer_bytes,
                                                                PortClient* client);
  /// Setup thread. The client hears no more afterwards.
  void leave(PortClient* client);
  ~SensorPort();

  /// I/O thread: the sensor sends to another port from now on, for all channels.
  void move_to(std::uint16_t port);
  /// That the kernel grants.
  [[nodiscard]] std::int64_t buffer_bytes() const { return buffer_bytes_; }
  /// I/O thread: datagrams that the kernel dropped because the buffer was full.
  [[nodiscard]] std::uint64_t dropped() const { return receiver_.dropped(); }

 private:
  SensorPort(std::string address, std::uint16_t port, std::int64_t buffer_bytes);
  Status open();
  void run();
  template <class F>
  void for_clients(F&& f);

  network::UdpReceiver receiver_;
  network::UdpPort udp_;
  std::int64_t buffer_bytes_ = 0;
  std::atomic<std::uint16_t> port_;
  std::mutex clients_mutex_;
  std::vector<PortClient*> clients_;
  Deadline deadline_;
  std::thread thread_;
};

}  // namespace rigor::ouster
