#include "drivers/modbus/modbus_server.h"

#include <fcntl.h>
#include <modbus/modbus.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <deque>
#include <mutex>
#include <optional>
#include <vector>

#include "drivers/modbus/register_map.h"

namespace rigor::modbus {
namespace {

constexpr std::size_t kHeader = 6;  // transaction, protocol, length; the length counts what follows
constexpr std::size_t kMaxFrame = MODBUS_TCP_MAX_ADU_LENGTH;

std::uint16_t be16(const std::uint8_t* p) { return static_cast<std::uint16_t>(p[0] << 8 | p[1]); }

/// What a request asks of the model, checked against the length that really came.
struct Order {
  std::optional<RegisterTable> write_table, read_table;
  std::uint16_t write_address = 0, write_count = 0, read_address = 0, read_count = 0;
  std::array<std::uint16_t, MODBUS_MAX_WRITE_BITS> values{};
  bool mask = false;
  std::uint16_t and_mask = 0, or_mask = 0;
  int refusal = 0;  ///< a Modbus exception code
};

bool count_fits(std::uint16_t address, std::uint16_t count, unsigned max, int& refusal) {
  if (count < 1 || count > max) return refusal = MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE, false;
  if (unsigned{address} + count > 65536) return refusal = MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS, false;
  return true;
}

/// `pdu` begins with the function code. Nothing when its length is not that of its function.
std::optional<Order> parse_order(const std::uint8_t* pdu, std::size_t size) {
  Order o;
  const auto need = [&](std::size_t n) { return size == n; };
  const auto read = [&](RegisterTable table, unsigned max) -> std::optional<Order> {
    if (!need(5)) return std::nullopt;
    o.read_table = table;
    o.read_address = be16(pdu + 1);
    o.read_count = be16(pdu + 3);
    (void)count_fits(o.read_address, o.read_count, max, o.refusal);
    return o;
  };
  switch (pdu[0]) {
    case MODBUS_FC_READ_COILS:
      return read(RegisterTable::coils, MODBUS_MAX_READ_BITS);
    case MODBUS_FC_READ_DISCRETE_INPUTS:
      return read(RegisterTable::discrete_inputs, MODBUS_MAX_READ_BITS);
    case MODBUS_FC_READ_HOLDING_REGISTERS:
      return read(RegisterTable::holding_registers, MODBUS_MAX_READ_REGISTERS);
    case MODBUS_FC_READ_INPUT_REGISTERS:
      return read(RegisterTable::input_registers, MODBUS_MAX_READ_REGISTERS);
    case MODBUS_FC_WRITE_SINGLE_COIL:
    case MODBUS_FC_WRITE_SINGLE_REGISTER: {
      if (!need(5)) return std::nullopt;
      const bool coil = pdu[0] == MODBUS_FC_WRITE_SINGLE_COIL;
      o.write_table = coil ? RegisterTable::coils : RegisterTable::holding_registers;
      o.write_address = be16(pdu + 1);
      o.write_count = 1;
      o.values[0] = be16(pdu + 3);
      if (coil && o.values[0] != 0 && o.values[0] != 0xFF00) o.refusal = MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
      if (coil) o.values[0] = o.values[0] != 0;
      return o;
    }
    case MODBUS_FC_WRITE_MULTIPLE_COILS: {
      if (size < 6) return std::nullopt;
      o.write_table = RegisterTable::coils;
      o.write_address = be16(pdu + 1);
      o.write_count = be16(pdu + 3);
      if (!count_fits(o.write_address, o.write_count, MODBUS_MAX_WRITE_BITS, o.refusal)) return o;
      const std::size_t bytes = (o.write_count + 7u) / 8u;
      if (pdu[5] != bytes || !need(6 + bytes)) return std::nullopt;
      for (std::size_t i = 0; i < o.write_count; ++i)
        o.values[i] = static_cast<std::uint16_t>((pdu[6 + i / 8] >> (i % 8)) & 1);
      return o;
    }
    case MODBUS_FC_WRITE_MULTIPLE_REGISTERS: {
      if (size < 6) return std::nullopt;
      o.write_table = RegisterTable::holding_registers;
      o.write_address = be16(pdu + 1);
      o.write_count = be16(pdu + 3);
      if (!count_fits(o.write_address, o.write_count, MODBUS_MAX_WRITE_REGISTERS, o.refusal)) return o;
      const std::size_t bytes = o.write_count * std::size_t{2};
      if (pdu[5] != bytes || !need(6 + bytes)) return std::nullopt;
      for (std::size_t i = 0; i < o.write_count; ++i) o.values[i] = be16(pdu + 6 + 2 * i);
      return o;
    }
    case MODBUS_FC_MASK_WRITE_REGISTER:
      if (!need(7)) return std::nullopt;
      o.mask = true;
      o.write_table = RegisterTable::holding_registers;
      o.write_address = be16(pdu + 1);
      o.write_count = 1;
      o.and_mask = be16(pdu + 3);
      o.or_mask = be16(pdu + 5);
      return o;
    case MODBUS_FC_WRITE_AND_READ_REGISTERS: {
      if (size < 10) return std::nullopt;
      o.read_table = o.write_table = RegisterTable::holding_registers;
      o.read_address = be16(pdu + 1);
      o.read_count = be16(pdu + 3);
      o.write_address = be16(pdu + 5);
      o.write_count = be16(pdu + 7);
      if (!count_fits(o.read_address, o.read_count, MODBUS_MAX_WR_READ_REGISTERS, o.refusal) ||
          !count_fits(o.write_address, o.write_count, MODBUS_MAX_WR_WRITE_REGISTERS, o.refusal))
        return o;
      const std::size_t bytes = o.write_count * std::size_t{2};
      if (pdu[9] != bytes || !need(10 + bytes)) return std::nullopt;
      for (std::size_t i = 0; i < o.write_count; ++i) o.values[i] = be16(pdu + 10 + 2 * i);
      return o;
    }
    default:
      o.refusal = MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
      return o;
  }
}

struct ContextFree {
  void operator()(modbus_t* m) const noexcept { modbus_free(m); }
};
struct MappingFree {
  void operator()(modbus_mapping_t* m) const noexcept { modbus_mapping_free(m); }
};

struct Client {
  int socket = -1;
  std::array<std::uint8_t, 4 * kMaxFrame> data{};
  std::size_t size = 0;
  MonotonicTime last_heard, frame_since;
};

}  // namespace

struct Server::Loop {
  Loop(std::shared_ptr<RegisterModel> m, std::function<BenchTime()> n, Options o, Counters& c)
      : model(std::move(m)), now(std::move(n)), options(o), counters(c), faults(o.faults) {}
  ~Loop() {
    for (auto& client : clients) ::close(client.socket);
    if (listener >= 0) ::close(listener);
    if (wake >= 0) ::close(wake);
  }

  void run();
  void accept_one();
  bool receive(Client& c);
  bool serve_frames(Client& c);
  bool answer(Client& c, const std::uint8_t* frame, std::size_t size);
  int carry_out(Order& o);
  void count_clients();

  std::shared_ptr<RegisterModel> model;
  std::function<BenchTime()> now;
  Options options;
  Counters& counters;
  int listener = -1, wake = -1;
  std::atomic<bool> stopping{false};
  std::function<void(unsigned)> tell;
  std::deque<Client> clients;
  std::unique_ptr<modbus_t, ContextFree> context;
  std::unique_ptr<modbus_mapping_t, MappingFree> mapping;
  std::mutex faults_mutex;
  ServerFaults faults;
  std::uint64_t seen = 0;  // requests of well-formed frames, for the faults
};

/// Writes, then reads, as one request asks; the result of a read stands in the mapping. Returns an exception
/// code.
int Server::Loop::carry_out(Order& o) {
  if (o.refusal != 0) return o.refusal;
  const BenchTime t = now();
  if (o.write_table) {
    if (o.mask) {
      std::uint16_t old = 0;
      if (!model->read(*o.write_table, o.write_address, {&old, 1}, t))
        return MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
      o.values[0] = static_cast<std::uint16_t>((old & o.and_mask) | (o.or_mask & ~o.and_mask));
    }
    if (!model->write(*o.write_table, o.write_address, {o.values.data(), o.write_count}, t))
      return MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
  }
  if (o.read_table) {
    std::array<std::uint16_t, MODBUS_MAX_READ_BITS> out{};
    if (!model->read(*o.read_table, o.read_address, {out.data(), o.read_count}, t))
      return MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
    for (std::size_t i = 0; i < o.read_count; ++i) {
      const std::size_t a = o.read_address + i;
      switch (*o.read_table) {
        case RegisterTable::coils:
          mapping->tab_bits[a] = out[i] != 0;
          break;
        case RegisterTable::discrete_inputs:
          mapping->tab_input_bits[a] = out[i] != 0;
          break;
        case RegisterTable::input_registers:
          mapping->tab_input_registers[a] = out[i];
          break;
        case RegisterTable::holding_registers:
          mapping->tab_registers[a] = out[i];
          break;
      }
    }
    // modbus_reply writes before it reads: let it write what is to be read anyway where the ranges overlap.
    if (o.write_table)
      for (std::size_t i = 0; i < o.read_count; ++i) {
        const std::size_t a = o.read_address + i;
        if (a >= o.write_address && a < std::size_t{o.write_address} + o.write_count)
          o.values[a - o.write_address] = out[i];
      }
  }
  return 0;
}

/// False when the connection is to be closed.
bool Server::Loop::answer(Client& c, const std::uint8_t* frame, std::size_t size) {
  auto order = parse_order(frame + kHeader + 1, size - kHeader - 1);
  if (!order) {
    counters.malformed.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  counters.requests.fetch_add(1, std::memory_order_relaxed);
  ServerFaults f;
  {
    const std::lock_guard lock(faults_mutex);
    f = faults;
  }
  ++seen;
  if (f.silent_every != 0 && seen % f.silent_every == 0) return true;
  modbus_set_socket(context.get(), c.socket);
  const int refusal =
      f.exception_every != 0 && seen % f.exception_every == 0 ? f.exception_code : carry_out(*order);
  int sent = 0;
  if (refusal != 0) {
    counters.exceptions.fetch_add(1, std::memory_order_relaxed);
    sent = modbus_reply_exception(context.get(), frame, static_cast<unsigned>(refusal));
  } else {
    std::array<std::uint8_t, kMaxFrame> copy{};
    std::copy_n(frame, size, copy.begin());
    if (frame[kHeader + 1] == MODBUS_FC_WRITE_AND_READ_REGISTERS)
      for (std::size_t i = 0; i < order->write_count; ++i) {
        copy[kHeader + 11 + 2 * i] = static_cast<std::uint8_t>(order->values[i] >> 8);
        copy[kHeader + 12 + 2 * i] = static_cast<std::uint8_t>(order->values[i]);
      }
    sent = modbus_reply(context.get(), copy.data(), static_cast<int>(size), mapping.get());
  }
  return sent > 0;  // a client that does not take its answers is dropped
}

/// Serves what has come in whole. False when the connection is to be closed.
bool Server::Loop::serve_frames(Client& c) {
  std::size_t at = 0;
  bool keep = true;
  while (keep && c.size - at >= kHeader) {
    const auto* frame = c.data.data() + at;
    const std::size_t length = be16(frame + 4);
    if (be16(frame + 2) != 0 || length < 2 || kHeader + length > kMaxFrame) {
      counters.malformed.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    if (c.size - at < kHeader + length) break;
    Duration delay;
    {
      const std::lock_guard lock(faults_mutex);
      delay = faults.response_delay;
    }
    if (delay.ns() > 0 && monotonic_now() - c.frame_since < delay) break;
    keep = answer(c, frame, kHeader + length);
    at += kHeader + length;
    c.frame_since = monotonic_now();
  }
  std::memmove(c.data.data(), c.data.data() + at, c.size - at);
  c.size -= at;
  return keep;
}

bool Server::Loop::receive(Client& c) {
  const auto n = ::recv(c.socket, c.data.data() + c.size, c.data.size() - c.size, MSG_DONTWAIT);
  if (n == 0) return false;
  if (n < 0) return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
  c.last_heard = monotonic_now();
  if (c.size == 0) c.frame_since = c.last_heard;
  c.size += static_cast<std::size_t>(n);
  return true;
}

void Server::Loop::accept_one() {
  const int s = ::accept4(listener, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (s < 0) return;
  if (clients.size() >= options.max_clients) {
    counters.turned_away.fetch_add(1, std::memory_order_relaxed);
    ::close(s);
    return;
  }
  const int on = 1;
  ::setsockopt(s, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  ::setsockopt(s, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
  clients.emplace_back();
  clients.back().socket = s;
  clients.back().last_heard = monotonic_now();
  count_clients();
}

void Server::Loop::count_clients() {
  const auto n = static_cast<std::uint32_t>(clients.size());
  if (counters.clients.exchange(n, std::memory_order_acq_rel) != n && tell) tell(n);
}

void Server::Loop::run() {
  std::vector<pollfd> fds;
  while (!stopping.load(std::memory_order_acquire)) {
    fds.clear();
    fds.push_back({wake, POLLIN, 0});
    fds.push_back({listener, POLLIN, 0});  // a negative one is ignored
    Duration delay;
    {
      const std::lock_guard lock(faults_mutex);
      delay = faults.response_delay;
    }
    int wait_ms = options.idle_limit.ns() > 0 && !clients.empty() && listener >= 0 ? 1000 : -1;
    const auto at = monotonic_now();
    for (const auto& c : clients) {
      // A full buffer is read no further until its requests are answered.
      fds.push_back({c.socket, static_cast<short>(c.size < c.data.size() ? POLLIN : 0), 0});
      if (delay.ns() > 0 && c.size >= kHeader) {
        const auto left = (c.frame_since + delay - at).ns();
        const int ms = left <= 0 ? 1 : static_cast<int>(std::min<std::int64_t>(left / 1'000'000 + 1, 1000));
        wait_ms = wait_ms < 0 ? ms : std::min(wait_ms, ms);
      }
    }
    if (::poll(fds.data(), fds.size(), wait_ms) < 0 && errno != EINTR) return;
    const auto t = monotonic_now();
    for (std::size_t i = 0; i < clients.size(); ++i) {
      auto& c = clients[i];
      bool keep = true;
      if (fds[i + 2].revents != 0) keep = (fds[i + 2].revents & POLLIN) != 0 ? receive(c) : false;
      if (keep && c.size > 0) keep = serve_frames(c);
      // Sockets of virtual time are never idle for long by any clock that means something.
      if (keep && listener >= 0 && options.idle_limit.ns() > 0 && t - c.last_heard > options.idle_limit)
        keep = false;
      if (!keep) {
        ::close(c.socket);
        c.socket = -1;
        counters.dropped.fetch_add(1, std::memory_order_relaxed);
      }
    }
    std::erase_if(clients, [](const Client& c) { return c.socket < 0; });
    count_clients();
    if ((fds[1].revents & POLLIN) != 0) accept_one();
  }
}

Server::Server(std::shared_ptr<RegisterModel> model, std::function<BenchTime()> now, Options options)
    : loop_(std::make_unique<Loop>(std::move(model), std::move(now), options, counters_)) {}

Server::~Server() { stop(); }

Status Server::listen(const std::string& address, std::uint16_t port) {
  const std::string where = address + ":" + std::to_string(port);
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (const int rc = ::getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found); rc != 0)
    return fail(ErrorCode::not_found, where,
                std::string("expected an address of this machine, got: ") + gai_strerror(rc));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owned(found, &::freeaddrinfo);
  const int s = ::socket(found->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (s < 0) return fail(ErrorCode::io, where, std::string("cannot open a socket: ") + std::strerror(errno));
  const int on = 1;
  ::setsockopt(s, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (::bind(s, found->ai_addr, found->ai_addrlen) != 0 || ::listen(s, 16) != 0) {
    const int e = errno;
    ::close(s);
    if (e == EADDRNOTAVAIL)
      return fail(ErrorCode::not_found, where,
                  "expected an address of this machine, got one that it does not have");
    std::string cure;
    if (e == EADDRINUSE) cure = "; another program has the port: stop it or give another `port`";
    if (e == EACCES) cure = "; ports below 1024 need CAP_NET_BIND_SERVICE: give a `port` of 1024 or more";
    return fail(ErrorCode::unavailable, where,
                std::string("cannot serve Modbus here: ") + std::strerror(e) + cure);
  }
  sockaddr_storage bound{};
  socklen_t size = sizeof bound;
  ::getsockname(s, reinterpret_cast<sockaddr*>(&bound), &size);
  port_ = ntohs(bound.ss_family == AF_INET6 ? reinterpret_cast<const sockaddr_in6&>(bound).sin6_port
                                            : reinterpret_cast<const sockaddr_in&>(bound).sin_port);
  if (loop_->listener >= 0) ::close(loop_->listener);
  loop_->listener = s;
  return {};
}

void Server::on_clients(std::function<void(unsigned)> tell) { loop_->tell = std::move(tell); }

void Server::adopt(int socket) {
  loop_->clients.emplace_back();
  loop_->clients.back().socket = socket;
  loop_->clients.back().last_heard = monotonic_now();
  counters_.clients.store(static_cast<std::uint32_t>(loop_->clients.size()), std::memory_order_release);
}

Status Server::start() {
  auto& l = *loop_;
  l.context.reset(modbus_new_tcp("127.0.0.1", 502));  // never connected: it only words answers
  // Every address in every table; what exists is the model's to say.
  l.mapping.reset(modbus_mapping_new(65536, 65536, 65536, 65536));
  l.wake = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (!l.context || !l.mapping || l.wake < 0)
    return fail(ErrorCode::io, "", std::string("cannot start a Modbus server: ") + std::strerror(errno));
  modbus_set_response_timeout(l.context.get(), 0,
                              1);  // libmodbus sleeps so long before it refuses some requests
  l.stopping.store(false, std::memory_order_release);
  thread_ = std::thread([&l] { l.run(); });
  return {};
}

void Server::stop() {
  if (!thread_.joinable()) return;
  loop_->stopping.store(true, std::memory_order_release);
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto n = ::write(loop_->wake, &one, sizeof one);
  thread_.join();
  ::close(loop_->wake);
  loop_->wake = -1;
  for (auto& c : loop_->clients) ::close(c.socket);
  loop_->clients.clear();
  counters_.clients.store(0, std::memory_order_release);
  if (loop_->listener >= 0) ::close(loop_->listener);
  loop_->listener = -1;
}

void Server::set_faults(const ServerFaults& faults) {
  const std::lock_guard lock(loop_->faults_mutex);
  loop_->faults = faults;
}

}  // namespace rigor::modbus
