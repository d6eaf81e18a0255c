// The thread of a source that listens to UDP ports: waits for all of them, opens an interface that went away
// again with growing pauses, keeps UTC tied to bench time, and ends when it is cut.
#pragma once

#include <functional>
#include <span>
#include <string>

#include "drivers/network/udp_receiver.h"
#include "rt-core/deadline.h"

namespace rigor::network {

struct UdpPort {
  UdpReceiver* receiver = nullptr;
  std::string address;
  std::uint16_t port = 0;
  std::int64_t buffer_bytes = 0;
  std::size_t max_bytes = kMtu;
  /// I/O thread: one batch at a time, until nothing is left.
  std::function<void(std::span<const UdpReceiver::Datagram>)> take;

  [[nodiscard]] Status open() { return receiver->open(address, port, buffer_bytes, max_bytes); }
};

/// I/O thread. Ports whose receiver is closed are opened. `epoch` is called at first and each second;
/// `turn` after each wait, at least ten times a second. Returns when `deadline` was cut.
void serve_ports(std::span<UdpPort> ports, Deadline& deadline,
                 const std::function<void(const EpochPair&)>& epoch, const std::function<void()>& turn);

}  // namespace rigor::network
