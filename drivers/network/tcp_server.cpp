#include "drivers/network/tcp_server.h"

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <vector>

#include "drivers/network/tcp_socket.h"

namespace rigor::network {

Result<std::uint16_t> TcpServer::listen(const std::string& address, std::uint16_t port, const Limits& limits,
                                        Serve serve) {
  auto made = listen_tcp(address, port, "clients");
  if (!made) return tl::unexpected<Error>(made.error());
  ports_.push_back({std::move(made->socket), limits, std::move(serve)});
  return made->port;
}

Status TcpServer::start() {
  wake_.reset(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!wake_) return fail(ErrorCode::io, "", std::string("expected an eventfd: ") + std::strerror(errno));
  ending_ = false;
  thread_ = std::thread([this] { run(); });
  return {};
}

void TcpServer::wake() {
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto n = ::write(wake_.get(), &one, sizeof one);
}

void TcpServer::stop() {
  if (thread_.joinable()) {
    ending_ = true;
    wake();
    thread_.join();
  }
  connections_.clear();
  ports_.clear();
  wake_.reset();
}

void TcpServer::accept(const Port& port) {
  TcpClient client = accept_tcp(port.socket);
  if (!client.socket) return;
  const auto here = std::count_if(connections_.begin(), connections_.end(),
                                  [&](const Connection& c) { return c.port == &port; });
  if (static_cast<std::size_t>(here) >= port.limits.clients) return;
  connections_.push_back(
      {std::move(client.socket), &port, {client.address, {}, {}, false, {}}, monotonic_now()});
}

void TcpServer::send(Connection& c) {
  std::string& out = c.client.out;
  std::size_t sent = 0;
  while (sent < out.size()) {
    const ssize_t n =
        ::send(c.socket.get(), out.data() + sent, out.size() - sent, MSG_DONTWAIT | MSG_NOSIGNAL);
    if (n > 0) {
      sent += static_cast<std::size_t>(n);
      c.moved = monotonic_now();
    } else if (n < 0 && errno == EINTR) {
      continue;
    } else {
      c.dead = !(n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK));
      break;
    }
  }
  out.erase(0, sent);
  if (out.empty() && c.client.close) c.dead = true;
}

void TcpServer::receive(Connection& c) {
  char piece[4096];
  const ssize_t n = recv(c.socket.get(), piece, sizeof piece, MSG_DONTWAIT);
  if (n == 0 || (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR)) c.dead = true;
  if (n <= 0 || c.client.close) return;
  c.moved = monotonic_now();
  c.client.in.append(piece, static_cast<std::size_t>(n));
  serve(c);
}

void TcpServer::serve(Connection& c) {
  c.port->serve(c.client);
  if (c.client.in.size() > c.port->limits.request || c.client.out.size() > c.port->limits.pending)
    c.dead = true;
  if (!c.dead) send(c);
}

void TcpServer::run() {
  pthread_setname_np(pthread_self(), "tcp-server");
  std::vector<pollfd> fds;
  while (true) {
    fds.assign(1, {wake_.get(), POLLIN, 0});
    for (const Port& p : ports_) fds.push_back({p.socket.get(), POLLIN, 0});
    for (const Connection& c : connections_)
      fds.push_back({c.socket.get(), static_cast<short>(POLLIN | (c.client.out.empty() ? 0 : POLLOUT)), 0});
    if (::poll(fds.data(), fds.size(), 500) < 0 && errno != EINTR) return;
    if (fds[0].revents != 0) {
      if (ending_) return;
      std::uint64_t times = 0;
      [[maybe_unused]] const auto n = ::read(wake_.get(), &times, sizeof times);
      for (Connection& c : connections_)
        if (!c.client.close) serve(c);
    }
    const MonotonicTime now = monotonic_now();
    std::size_t k = 1 + ports_.size();
    for (Connection& c : connections_) {  // new ones come behind those that were polled
      const short events = fds[k++].revents;
      if ((events & (POLLIN | POLLHUP)) != 0) receive(c);
      if ((events & (POLLERR | POLLNVAL)) != 0) c.dead = true;
      if ((events & POLLOUT) != 0 && !c.dead) send(c);
      if (now - c.moved > c.port->limits.idle) c.dead = true;
    }
    connections_.remove_if([](const Connection& c) { return c.dead; });
    std::size_t p = 1;
    for (const Port& port : ports_)
      if ((fds[p++].revents & POLLIN) != 0) accept(port);
  }
}

}  // namespace rigor::network
