#include "drivers/network/udp_sender.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>

namespace rigor::network {

Status UdpSender::open(const std::string& address, std::uint16_t port, const std::string& from_address,
                       std::uint16_t from_port) {
  socket_.reset();
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  if (inet_pton(AF_INET, address.c_str(), &to.sin_addr) != 1)
    return fail(ErrorCode::bad_input, address, "expected an IPv4 address like 192.168.1.10");
  socket_.reset(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  const int on = 1;
  if (!socket_ || setsockopt(socket_.get(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on) != 0)
    return fail(ErrorCode::io, address, std::string("expected a UDP socket: ") + std::strerror(errno));
  destination_ipv4_ = ntohl(to.sin_addr.s_addr);
  from_port_ = from_port;
  if (!from_address.empty() || from_port != 0) {
    sockaddr_in from{};
    from.sin_family = AF_INET;
    from.sin_port = htons(from_port);
    if (!from_address.empty() && inet_pton(AF_INET, from_address.c_str(), &from.sin_addr) != 1) {
      socket_.reset();
      return fail(ErrorCode::bad_input, from_address, "expected an IPv4 address of this machine");
    }
    if (bind(socket_.get(), reinterpret_cast<const sockaddr*>(&from), sizeof from) != 0) {
      const int why = errno;
      socket_.reset();
      return fail(ErrorCode::unavailable, from_address + ":" + std::to_string(from_port),
                  std::string("expected to send from here: ") + std::strerror(why));
    }
  }
  // Connected: which address of ours leads there, and what nobody takes is answered.
  if (connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
    const int why = errno;
    socket_.reset();
    return fail(
        ErrorCode::unavailable, address,
        std::string("expected a way to this address: ") + std::strerror(why) + "; `ip route` lists them");
  }
  sockaddr_in local{};
  socklen_t length = sizeof local;
  if (getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&local), &length) == 0)
    local_ipv4_ = ntohl(local.sin_addr.s_addr);
  return {};
}

Status UdpSender::record(const std::filesystem::path& file) {
  auto writer = PcapWriter::create(file);
  if (!writer) return tl::unexpected<Error>(writer.error());
  pcap_.emplace(std::move(*writer));
  return {};
}

Status UdpSender::finish_recording() {
  Status written;
  if (pcap_) written = pcap_->flush();
  pcap_.reset();
  return written;
}

UdpSender::Outcome UdpSender::send(std::span<const std::uint8_t> bytes, std::uint16_t port, RealtimeTime t) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(destination_ipv4_);
  const auto once = [&] {
    return sendto(socket_.get(), bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to),
                  sizeof to);
  };
  Outcome outcome = Outcome::sent;
  if (once() < 0) {
    outcome = errno == ECONNREFUSED ? Outcome::nobody : Outcome::failed;
    if (outcome == Outcome::nobody) (void)once();  // the answer was to an earlier one
  }
  if (pcap_)
    pcap_->write(t, {local_ipv4_, destination_ipv4_, from_port_ != 0 ? from_port_ : port, port, bytes});
  return outcome;
}

}  // namespace rigor::network
