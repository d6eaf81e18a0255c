#include "drivers/network/udp_receiver.h"

#include <arpa/inet.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace rigor::network {

Status UdpReceiver::open(const std::string& address, std::uint16_t port, std::int64_t buffer_bytes,
                         std::size_t max_bytes) {
  close();
  // One more, so that what is cut is longer than what fits.
  max_bytes_ = max_bytes + 1;
  data_.resize(kBatch * max_bytes_);
  const std::string where = address + ":" + std::to_string(port);
  fd_.reset(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd_) return fail(ErrorCode::io, where, std::string("expected a UDP socket: ") + std::strerror(errno));
  const int on = 1, bytes = static_cast<int>(buffer_bytes);
  (void)setsockopt(fd_.get(), SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
  (void)setsockopt(fd_.get(), SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
  if (setsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUFFORCE, &bytes, sizeof bytes) != 0)
    (void)setsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  int granted = 0;
  socklen_t length = sizeof granted;
  if (getsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUF, &granted, &length) == 0) buffer_bytes_ = granted / 2;
  sockaddr_in local{};
  local.sin_family = AF_INET;
  local.sin_port = htons(port);
  if (inet_pton(AF_INET, address.c_str(), &local.sin_addr) != 1)
    return fail(ErrorCode::bad_input, where, "expected an IPv4 address of this machine, or 0.0.0.0");
  if (bind(fd_.get(), reinterpret_cast<const sockaddr*>(&local), sizeof local) != 0) {
    const int why = errno;
    close();
    return fail(ErrorCode::unavailable, where,
                std::string("expected to take packets here: ") + std::strerror(why) +
                    (why == EADDRINUSE ? "; another program has this port (ss -lunp shows which)"
                                       : "; `ip addr` lists this machine's addresses"));
  }
  length = sizeof local;
  if (getsockname(fd_.get(), reinterpret_cast<sockaddr*>(&local), &length) == 0)
    port_ = ntohs(local.sin_port);
  dropped_last_ = 0;
  for (std::size_t i = 0; i < kBatch; ++i) {
    vector_[i] = {data_.data() + i * max_bytes_, max_bytes_};
    header_[i] = {};
    header_[i].msg_hdr.msg_iov = &vector_[i];
    header_[i].msg_hdr.msg_iovlen = 1;
    header_[i].msg_hdr.msg_name = &from_[i];
    header_[i].msg_hdr.msg_control = control_[i].data();
  }
  return {};
}

std::span<const UdpReceiver::Datagram> UdpReceiver::receive(const EpochPair& epoch) noexcept {
  for (mmsghdr& h : header_) {
    h.msg_hdr.msg_namelen = sizeof(sockaddr_in);
    h.msg_hdr.msg_controllen = control_[0].size();
  }
  const int n = recvmmsg(fd_.get(), header_.data(), kBatch, MSG_DONTWAIT, nullptr);
  if (n <= 0) return {};
  const BenchTime now(monotonic_now().ns());
  std::size_t count = 0;
  for (int i = 0; i < n; ++i) {
    msghdr& h = header_[i].msg_hdr;
    BenchTime arrival = now;
    for (cmsghdr* c = CMSG_FIRSTHDR(&h); c; c = CMSG_NXTHDR(&h, c)) {
      if (c->cmsg_level != SOL_SOCKET) continue;
      if (c->cmsg_type == SCM_TIMESTAMPNS) {
        timespec ts{};
        std::memcpy(&ts, CMSG_DATA(c), sizeof ts);
        const BenchTime kernel = epoch.to_bench(RealtimeTime(ts.tv_sec * 1'000'000'000 + ts.tv_nsec));
        // A clock that was set in between would make nonsense of it.
        if (kernel <= now && now - kernel < seconds(2)) arrival = kernel;
      } else if (c->cmsg_type == SO_RXQ_OVFL) {
        std::uint32_t all = 0;
        std::memcpy(&all, CMSG_DATA(c), sizeof all);
        dropped_ += all - dropped_last_;
        dropped_last_ = all;
      }
    }
    got_[count++] = {{data_.data() + static_cast<std::size_t>(i) * max_bytes_, header_[i].msg_len},
                     arrival,
                     ntohl(from_[static_cast<std::size_t>(i)].sin_addr.s_addr)};
  }
  return {got_.data(), count};
}

}  // namespace rigor::network
