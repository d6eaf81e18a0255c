#include "drivers/network/udp_sender.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>

namespace rigor::network {

Status UdpSender::open(const std::string& address, std::uint16_t port) {
  close();
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
  // Connected: which address of ours leads there, and what nobody takes is answered.
  if (connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
    const int why = errno;
    close();
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
  if (pcap_) pcap_->write(t, {local_ipv4_, destination_ipv4_, port, port, bytes});
  return outcome;
}

}  // namespace rigor::network
