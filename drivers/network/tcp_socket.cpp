#include "drivers/network/tcp_socket.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>

namespace rigor::network {
namespace {

using Addresses = std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)>;

/// Empty, with `why`, where the name means no address.
Addresses addresses_of(const std::string& address, std::uint16_t port, int flags, const char*& why) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV | flags;
  addrinfo* found = nullptr;
  const int rc = ::getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (rc != 0) why = ::gai_strerror(rc);
  return {rc == 0 ? found : nullptr, &::freeaddrinfo};
}

FileDescriptor socket_for(const addrinfo& a) {
  return FileDescriptor(::socket(a.ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
}

void set_option(const FileDescriptor& s, int level, int name, int value) {
  (void)::setsockopt(s.get(), level, name, &value, sizeof value);
}

/// 0 or the errno. `limit` holds for this address.
int connect_to(const FileDescriptor& s, const addrinfo& a, MonotonicTime limit, int cut_fd) {
  if (::connect(s.get(), a.ai_addr, a.ai_addrlen) == 0) return 0;
  if (errno != EINPROGRESS && errno != EINTR) return errno;  // interrupted: it goes on by itself
  if (const int e = wait_for_socket(s.get(), POLLOUT, limit, cut_fd); e != 0) return e;
  int error = 0;
  socklen_t size = sizeof error;
  return ::getsockopt(s.get(), SOL_SOCKET, SO_ERROR, &error, &size) == 0 ? error : errno;
}

}  // namespace

std::string endpoint_text(const std::string& address, std::uint16_t port) {
  const bool six = address.find(':') != std::string::npos;
  return (six ? "[" + address + "]" : address) + ":" + std::to_string(port);
}

int wait_for_socket(int fd, short events, MonotonicTime limit, int cut_fd) noexcept {
  pollfd fds[2] = {{fd, events, 0}, {cut_fd, POLLIN, 0}};  // a descriptor below 0 is passed over
  while (true) {
    const std::int64_t left = std::clamp<std::int64_t>((limit - monotonic_now()).ns(), 0, seconds(3600).ns());
    const timespec t{left / 1'000'000'000, left % 1'000'000'000};
    const int n = ::ppoll(fds, 2, &t, nullptr);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return errno;
    if (fds[1].revents != 0) return ECANCELED;
    if (fds[0].revents != 0) return 0;
    if (monotonic_now() >= limit) return ETIMEDOUT;
  }
}

Result<FileDescriptor> connect_tcp(const std::string& address, std::uint16_t port, MonotonicTime limit,
                                   int cut_fd, const std::string& device) {
  const std::string where = endpoint_text(address, port);
  const char* no_host = nullptr;
  const Addresses found = addresses_of(address, port, 0, no_host);
  if (!found)
    return fail(ErrorCode::not_found, where, std::string("expected a host name or address, got: ") + no_host);
  std::int64_t untried = 0;
  for (const addrinfo* a = found.get(); a; a = a->ai_next) ++untried;
  int error = EADDRNOTAVAIL;
  for (const addrinfo* a = found.get(); a; a = a->ai_next, --untried) {
    FileDescriptor s = socket_for(*a);
    if (!s) {
      error = errno;
      continue;
    }
    // An address that does not answer leaves time for the others.
    const MonotonicTime now = monotonic_now();
    const MonotonicTime share = limit > now ? now + Duration((limit - now).ns() / untried) : limit;
    error = connect_to(s, *a, share, cut_fd);
    if (error == 0) {
      set_option(s, IPPROTO_TCP, TCP_NODELAY, 1);
      return s;
    }
    if (error == ECANCELED) break;
  }
  return fail(ErrorCode::not_found, where,
              "expected " + device + " that listens here, got: " + std::strerror(error));
}

Result<TcpListener> listen_tcp(const std::string& address, std::uint16_t port, const std::string& what) {
  const std::string where = endpoint_text(address, port);
  const char* no_address = nullptr;
  const Addresses found = addresses_of(address, port, AI_PASSIVE, no_address);
  if (!found)
    return fail(ErrorCode::bad_input, where,
                std::string("expected an address of this machine, got: ") + no_address);
  TcpListener l;
  l.socket = socket_for(*found);
  if (l.socket) set_option(l.socket, SOL_SOCKET, SO_REUSEADDR, 1);
  if (!l.socket || ::bind(l.socket.get(), found->ai_addr, found->ai_addrlen) != 0 ||
      ::listen(l.socket.get(), 16) != 0) {
    const int e = errno;
    if (e == EADDRNOTAVAIL)
      return fail(ErrorCode::not_found, where,
                  "expected an address of this machine, got one that it does not have; `ip addr` lists its "
                  "addresses");
    std::string cure;
    if (e == EADDRINUSE) cure = "; another program has the port: stop it or give another `port`";
    if (e == EACCES) cure = "; ports below 1024 need CAP_NET_BIND_SERVICE: give a `port` of 1024 or more";
    return fail(ErrorCode::unavailable, where, "cannot serve " + what + " here: " + std::strerror(e) + cure);
  }
  sockaddr_storage bound{};
  socklen_t size = sizeof bound;
  (void)::getsockname(l.socket.get(), reinterpret_cast<sockaddr*>(&bound), &size);
  l.port = ntohs(bound.ss_family == AF_INET6 ? reinterpret_cast<const sockaddr_in6&>(bound).sin6_port
                                             : reinterpret_cast<const sockaddr_in&>(bound).sin_port);
  return l;
}

TcpClient accept_tcp(const FileDescriptor& listener) {
  sockaddr_storage from{};
  socklen_t size = sizeof from;
  TcpClient c;
  c.socket.reset(
      ::accept4(listener.get(), reinterpret_cast<sockaddr*>(&from), &size, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (!c.socket) return c;
  set_option(c.socket, IPPROTO_TCP, TCP_NODELAY, 1);
  set_option(c.socket, SOL_SOCKET, SO_KEEPALIVE, 1);
  set_option(c.socket, IPPROTO_TCP, TCP_KEEPIDLE, 10);
  set_option(c.socket, IPPROTO_TCP, TCP_KEEPINTVL, 5);
  set_option(c.socket, IPPROTO_TCP, TCP_KEEPCNT, 3);
  char text[NI_MAXHOST] = {};
  if (::getnameinfo(reinterpret_cast<const sockaddr*>(&from), size, text, sizeof text, nullptr, 0,
                    NI_NUMERICHOST) == 0)
    c.address = text;
  return c;
}

}  // namespace rigor::network
