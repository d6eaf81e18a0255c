#include "drivers/sick/scanner_server.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <list>
#include <mutex>
#include <thread>

#include "drivers/network/tcp_socket.h"
#include "rt-core/deadline.h"
#include "rt-core/file_descriptor.h"

namespace rigor::sick {
namespace {

// The device was switched on a little before it is served, so that its clock is past zero.
constexpr Duration kDeviceAhead = seconds(10);

}  // namespace

struct ScannerServer::Impl {
  struct Client {
    Client(FileDescriptor s, std::size_t max_request) : socket(std::move(s)), parser(max_request) {}
    FileDescriptor socket;
    FrameParser parser;
    Session session;
    Buffer out;
    std::size_t sent = 0;  ///< of `out`
    MonotonicTime heard, moved;
    bool dead = false;
    [[nodiscard]] std::size_t pending() const { return out.size() - sent; }
  };

  Impl(ScannerConfig config, Measure m, Options o)
      : device(std::move(config)), measure(std::move(m)), options(o) {}

  ScannerDevice device;  // under `mutex`, as are the clients
  Measure measure;
  Options options;
  Counters counters;
  std::function<void(unsigned)> tell;
  std::mutex mutex;
  std::list<Client> clients;
  Buffer frame;
  FileDescriptor listener, wake;
  std::uint16_t port = 0;
  MonotonicTime switched_on;
  std::atomic<bool> stopping{false};
  std::thread serving, measuring;
  Deadline deadline;

  [[nodiscard]] DeviceTime device_now(MonotonicTime t) const {
    return DeviceTime((t - switched_on + kDeviceAhead).ns());
  }
  void serve();
  void scan();
  void accept_one();
  void receive(Client& c);
  void flush(Client& c);
  void send_scan();
  void count_clients();
};

ScannerServer::ScannerServer(ScannerConfig config, Measure measure, Options options)
    : impl_(std::make_unique<Impl>(std::move(config), std::move(measure), options)) {}

ScannerServer::~ScannerServer() { stop(); }

std::uint16_t ScannerServer::port() const noexcept { return impl_->port; }
const ScannerServer::Counters& ScannerServer::counters() const noexcept { return impl_->counters; }
MonotonicTime ScannerServer::switched_on() const noexcept { return impl_->switched_on; }
void ScannerServer::on_clients(std::function<void(unsigned)> tell) { impl_->tell = std::move(tell); }

Status ScannerServer::listen(const std::string& address, std::uint16_t port) {
  auto made = network::listen_tcp(address, port, "a scanner");
  if (!made) return tl::unexpected<Error>(made.error());
  // Clients inherit it.
  if (const int bytes = impl_->options.send_buffer; bytes > 0)
    ::setsockopt(made->socket.get(), SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
  impl_->listener = std::move(made->socket);
  impl_->port = made->port;
  return {};
}

void ScannerServer::adopt(int socket) {
  auto& c = impl_->clients.emplace_back(FileDescriptor(socket), impl_->options.max_request);
  c.heard = c.moved = monotonic_now();
}

Status ScannerServer::start() {
  Impl& i = *impl_;
  if (!i.wake) i.wake.reset(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!i.wake) return fail(ErrorCode::io, "", std::string("cannot start a scanner: ") + std::strerror(errno));
  if (auto s = i.deadline.open(); !s) return s;
  i.stopping = false;
  i.switched_on = monotonic_now();
  i.serving = std::thread([&i] { i.serve(); });
  if (i.measure) i.measuring = std::thread([&i] { i.scan(); });
  return {};
}

void ScannerServer::stop() {
  Impl& i = *impl_;
  if (!i.serving.joinable()) return;
  i.stopping = true;
  i.deadline.cut();
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto n = ::write(i.wake.get(), &one, sizeof one);
  i.serving.join();
  if (i.measuring.joinable()) i.measuring.join();
}

void ScannerServer::Impl::count_clients() {
  const auto n = static_cast<std::uint32_t>(clients.size());
  if (counters.clients.exchange(n, std::memory_order_acq_rel) != n && tell) tell(n);
}

void ScannerServer::Impl::accept_one() {
  FileDescriptor socket = network::accept_tcp(listener).socket;
  if (!socket) return;
  if (clients.size() >= options.max_clients) {
    counters.turned_away.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  const auto gone_ms = static_cast<unsigned>(options.stall_limit.ns() / 1'000'000);
  ::setsockopt(socket.get(), IPPROTO_TCP, TCP_USER_TIMEOUT, &gone_ms, sizeof gone_ms);
  auto& c = clients.emplace_back(std::move(socket), options.max_request);
  c.heard = c.moved = monotonic_now();
}

void ScannerServer::Impl::flush(Client& c) {
  while (c.pending() > 0 && !c.dead) {
    const auto n = ::send(c.socket.get(), c.out.data() + c.sent, c.pending(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (n > 0) {
      c.sent += static_cast<std::size_t>(n);
      c.moved = monotonic_now();
    } else if (n < 0 && errno == EINTR) {
      continue;
    } else if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
      return;
    } else {
      c.dead = true;
    }
  }
  c.out.clear();
  c.sent = 0;
  c.moved = monotonic_now();
}

void ScannerServer::Impl::receive(Client& c) {
  const auto n = ::recv(c.socket.get(), c.parser.room(4096).data(), 4096, MSG_DONTWAIT);
  if (n == 0 || (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR)) c.dead = true;
  if (n <= 0) return;
  c.parser.added(static_cast<std::size_t>(n));
  const auto now = monotonic_now();
  const auto bad_before = device.counters().malformed;
  for (Bytes body = c.parser.next(); body.data(); body = c.parser.next()) {
    counters.requests.fetch_add(1, std::memory_order_relaxed);
    c.heard = now;  // bytes that never become a request do not keep a place
    device.answer(c.session, body, device_now(now), c.out);
    // Who asks and does not read is no client.
    if (c.pending() > 2 * options.max_pending) c.dead = true;
  }
  counters.malformed.fetch_add(device.counters().malformed - bad_before, std::memory_order_relaxed);
  if (c.parser.skipped_bytes() > options.max_garbage) c.dead = true;
  flush(c);
}

void ScannerServer::Impl::serve() {
  std::vector<pollfd> fds;
  std::vector<Client*> served;
  while (!stopping.load(std::memory_order_acquire)) {
    fds.clear();
    served.clear();
    fds.push_back({wake.get(), POLLIN, 0});
    fds.push_back({listener.get(), POLLIN, 0});
    {
      const std::lock_guard lock(mutex);
      for (auto& c : clients) {
        fds.push_back({c.socket.get(), static_cast<short>(POLLIN | (c.pending() > 0 ? POLLOUT : 0)), 0});
        served.push_back(&c);  // only this thread takes clients out
      }
    }
    // Twice a second for the limits; nothing is late by that.
    if (::poll(fds.data(), fds.size(), 500) < 0 && errno != EINTR) return;
    if ((fds[0].revents & POLLIN) != 0) {
      std::uint64_t n = 0;
      [[maybe_unused]] const auto got = ::read(wake.get(), &n, sizeof n);
    }
    const std::lock_guard lock(mutex);
    const auto now = monotonic_now();
    for (std::size_t k = 0; k < served.size(); ++k) {
      Client& c = *served[k];
      const auto events = fds[k + 2].revents;
      if ((events & (POLLIN | POLLHUP)) != 0) receive(c);
      if ((events & (POLLERR | POLLNVAL)) != 0) c.dead = true;
      if ((events & POLLOUT) != 0 && !c.dead) flush(c);
      if (c.pending() > 0 && now - c.moved > options.stall_limit) c.dead = true;
      if (!c.session.scans && options.idle_limit.ns() > 0 && now - c.heard > options.idle_limit)
        c.dead = true;
    }
    const auto dropped = std::erase_if(clients, [](const Client& c) { return c.dead; });
    counters.dropped.fetch_add(dropped, std::memory_order_relaxed);
    if ((fds[1].revents & POLLIN) != 0) accept_one();
    count_clients();
  }
}

/// Under the lock.
void ScannerServer::Impl::send_scan() {
  frame.clear();
  for (auto& c : clients) {
    if (!c.session.scans || c.dead) continue;
    if (c.pending() > options.max_pending) {
      counters.scans_skipped.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    if (frame.empty()) device.append_scan(frame);
    c.out.insert(c.out.end(), frame.begin(), frame.end());
    flush(c);
    if (c.pending() > 0) {  // the serving thread waits for room
      const std::uint64_t one = 1;
      [[maybe_unused]] const auto n = ::write(wake.get(), &one, sizeof one);
    }
  }
}

void ScannerServer::Impl::scan() {
  const Duration period = device.period();
  for (std::uint64_t k = 0;; ++k) {
    MonotonicTime zero = switched_on + period * static_cast<std::int64_t>(k);
    if (const auto late = monotonic_now() - zero; late > period) {
      const auto missed = static_cast<std::uint64_t>(late / period);
      counters.scans_late.fetch_add(missed, std::memory_order_relaxed);
      k += missed;
      zero = switched_on + period * static_cast<std::int64_t>(k);
    }
    if (!deadline.wait_until(zero)) return;
    bool wanted = false;
    DeviceTime device_zero;
    Duration first, last;
    {
      const std::lock_guard lock(mutex);
      device_zero = device_now(zero);
      first = device.first_beam(device_zero) - device_zero;
      last = device.transmission(device_zero) - device_zero;
      wanted = device.measuring() && device.made_scan(k);
    }
    if (!wanted) continue;
    const auto points = measure(k, BenchTime(zero.ns()) + first);
    if (!points) {
      counters.scans_late.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    if (!deadline.wait_until(zero + last)) return;
    const std::lock_guard lock(mutex);
    const auto now = monotonic_now();
    device.set_scan(*points, k, device_zero, device_now(now));
    counters.scans.fetch_add(1, std::memory_order_relaxed);
    send_scan();
  }
}

}  // namespace rigor::sick
