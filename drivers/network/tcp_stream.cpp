#include "drivers/network/tcp_stream.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>

namespace rigor::network {

TcpStream::Outcome TcpStream::wait(short events, MonotonicTime limit) const {
  pollfd fds[2] = {{socket_, events, 0}, {cut_, POLLIN, 0}};
  while (true) {
    const std::int64_t left = std::max<std::int64_t>(0, (limit - monotonic_now()).ns());
    const timespec t{left / 1'000'000'000, left % 1'000'000'000};
    const int n = ::ppoll(fds, cut_ >= 0 ? 2 : 1, &t, nullptr);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return Outcome::closed;
    if (cut_ >= 0 && fds[1].revents != 0) return Outcome::cut;
    return n == 0 ? Outcome::timeout : Outcome::data;
  }
}

Status TcpStream::connect(const std::string& address, std::uint16_t port, MonotonicTime limit, int cut_fd) {
  close();
  cut_ = cut_fd;
  const bool six = address.find(':') != std::string::npos;
  const std::string where = (six ? "[" + address + "]" : address) + ":" + std::to_string(port);
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (const int rc = ::getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found); rc != 0)
    return fail(ErrorCode::not_found, where,
                std::string("expected a host name or address, got: ") + gai_strerror(rc));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owned(found, &::freeaddrinfo);
  std::string why = "no address";
  for (const addrinfo* a = found; a; a = a->ai_next) {
    socket_ = ::socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (socket_ < 0) {
      why = std::strerror(errno);
      continue;
    }
    int error = ::connect(socket_, a->ai_addr, a->ai_addrlen) == 0 ? 0 : errno;
    if (error == EINPROGRESS) {
      const Outcome o = wait(POLLOUT, limit);
      socklen_t size = sizeof error;
      if (o == Outcome::data) {
        ::getsockopt(socket_, SOL_SOCKET, SO_ERROR, &error, &size);
      } else {
        error = o == Outcome::timeout ? ETIMEDOUT : ECANCELED;
      }
    }
    if (error == 0) {
      const int on = 1;
      ::setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
      return {};
    }
    why = std::strerror(error);
    close();
  }
  return fail(ErrorCode::not_found, where, "expected a device that listens here, got: " + why);
}

void TcpStream::close() {
  if (socket_ >= 0) ::close(socket_);
  socket_ = -1;
}

TcpStream::Outcome TcpStream::receive(std::span<std::uint8_t> into, MonotonicTime limit, std::size_t& size) {
  size = 0;
  while (true) {
    if (const Outcome o = wait(POLLIN, limit); o != Outcome::data) return o;
    const auto n = ::recv(socket_, into.data(), into.size(), MSG_DONTWAIT);
    if (n > 0) {
      size = static_cast<std::size_t>(n);
      return Outcome::data;
    }
    if (n == 0 || (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR)) return Outcome::closed;
  }
}

bool TcpStream::send(std::span<const std::uint8_t> bytes, MonotonicTime limit) {
  while (!bytes.empty()) {
    const auto n = ::send(socket_, bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
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
