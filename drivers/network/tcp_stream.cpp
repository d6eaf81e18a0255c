#include "drivers/network/tcp_stream.h"

#include <poll.h>
#include <sys/socket.h>

#include <cerrno>
#include <utility>

#include "drivers/network/tcp_socket.h"

namespace rigor::network {

TcpStream::Outcome TcpStream::wait(short events, MonotonicTime limit) const {
  const int e = wait_for_socket(socket_.get(), events, limit, cut_);
  return e == 0           ? Outcome::data
         : e == ETIMEDOUT ? Outcome::timeout
         : e == ECANCELED ? Outcome::cut
                          : Outcome::closed;
}

Status TcpStream::connect(const std::string& address, std::uint16_t port, MonotonicTime limit, int cut_fd,
                          const std::string& device) {
  close();
  cut_ = cut_fd;
  auto made = connect_tcp(address, port, limit, cut_fd, device);
  if (!made) return tl::unexpected<Error>(made.error());
  socket_ = std::move(*made);
  return {};
}

TcpStream::Outcome TcpStream::receive(std::span<std::uint8_t> into, MonotonicTime limit, std::size_t& size) {
  size = 0;
  while (true) {
    if (const Outcome o = wait(POLLIN, limit); o != Outcome::data) return o;
    const auto n = ::recv(socket_.get(), into.data(), into.size(), MSG_DONTWAIT);
    if (n > 0) {
      size = static_cast<std::size_t>(n);
      return Outcome::data;
    }
    if (n == 0 || (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR)) return Outcome::closed;
  }
}

bool TcpStream::send(std::span<const std::uint8_t> bytes, MonotonicTime limit) {
  while (!bytes.empty()) {
    const auto n = ::send(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (n > 0) {
      bytes = bytes.subspan(static_cast<std::size_t>(n));
      continue;
    }
    if (n < 0 && errno == EINTR) continue;
    if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK) return false;
    if (wait(POLLOUT, limit) != Outcome::data) return false;
  }
  return true;
}

}  // namespace rigor::network
