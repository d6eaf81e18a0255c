#include "drivers/modbus/modbus_server.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <deque>
#include <vector>

#include "drivers/modbus/pdu.h"
#include "drivers/network/tcp_socket.h"
#include "rt-core/byte_order.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/time_slice.h"

namespace rigor::modbus {
namespace {

// MBAP header: transaction, protocol, length, unit; the length counts what follows it.
constexpr std::size_t kLengthEnd = 6, kHeader = 7;
constexpr std::size_t kMaxTcpFrame = kHeader + kMaxPdu;

/// One connection or line: bytes that came, and the answer that waits for its instant.
struct Client {
  /// A connection, closed with the client.
  Client(FileDescriptor connection, Server::Framing f) : Client(connection.get(), f, Server::Line{}) {
    own = std::move(connection);
  }
  /// A line, which is the caller's.
  Client(int fd, Server::Framing f, const Server::Line& l)
      : descriptor(fd), framing(f), line(l), last_heard(monotonic_now()), framer(l.times.gap, timeout(l)) {}
  /// How long half a frame is waited for: a pseudo-terminal's other end may be held up by its machine.
  static Duration timeout(const Server::Line& l) { return std::max(l.times.gap * 20, milliseconds(50)); }

  FileDescriptor own;
  int descriptor = -1;
  Server::Framing framing;
  Server::Line line;
  bool heard = false;        ///< a request came
  MonotonicTime last_heard;  ///< the last whole request, or the connection: bytes alone do not count

  // tcp
  std::array<std::uint8_t, 4 * kMaxTcpFrame> data{};
  std::size_t size = 0;
  MonotonicTime frame_since;
  // rtu
  RtuFramer framer;
  std::array<std::uint8_t, kMaxRtuFrame> request{};  ///< the frame that waits to be carried out
  std::size_t request_size = 0;
  MonotonicTime request_due;
  std::array<std::uint8_t, kMaxRtuFrame> answer{};
  std::size_t answer_size = 0;
  MonotonicTime answer_due;
};

/// The sooner of two instants to wake at.
void sooner(MonotonicTime& wake, MonotonicTime t) { wake = std::min(wake, t); }

}  // namespace

struct Server::Loop {
  Loop(std::shared_ptr<RegisterModel> m, std::function<BenchTime()> n, Options o, Counters& c, FaultBox& f)
      : model(std::move(m)), now(std::move(n)), options(o), counters(c), faults(f) {}
  ~Loop() { close_all(); }
  void close_all();

  void run();
  void accept_one();
  bool receive(Client& c);
  bool serve(Client& c, MonotonicTime& wake);
  bool serve_tcp(Client& c, MonotonicTime& wake);
  bool serve_rtu(Client& c, MonotonicTime& wake);
  bool answer_tcp(Client& c, const std::uint8_t* frame, std::size_t size);
  bool answer_rtu(Client& c);
  enum class Outcome : std::uint8_t { answer, silence, malformed };
  Outcome carry_out(std::span<const std::uint8_t> request, Exception refusal, Pdu& answer);
  void count_clients();

  std::shared_ptr<RegisterModel> model;
  std::function<BenchTime()> now;
  Options options;
  Counters& counters;
  FaultBox& faults;
  FileDescriptor listener, wake;
  std::atomic<bool> stopping{false};
  std::function<void(unsigned)> tell;
  std::deque<Client> clients;
};

void Server::Loop::close_all() {
  clients.clear();
  listener.reset();
  wake.reset();
}

Server::Loop::Outcome Server::Loop::carry_out(std::span<const std::uint8_t> request, Exception refusal,
                                              Pdu& answer) {
  const BenchTime t = now();
  const auto fate = faults.next(t);
  counters.requests.fetch_add(1, std::memory_order_relaxed);
  if (fate.silent) return Outcome::silence;
  if (refusal == Exception::none) refusal = fate.exception;
  if (refusal != Exception::none) {
    refuse(request, refusal, answer);
  } else if (!serve_request(*model, request, t, answer)) {
    counters.requests.fetch_sub(1, std::memory_order_relaxed);
    counters.malformed.fetch_add(1, std::memory_order_relaxed);
    return Outcome::malformed;
  }
  if (answer.exception != Exception::none) counters.exceptions.fetch_add(1, std::memory_order_relaxed);
  return Outcome::answer;
}

/// False when the connection is to be closed.
bool Server::Loop::answer_tcp(Client& c, const std::uint8_t* frame, std::size_t size) {
  const std::uint8_t unit = frame[kLengthEnd];
  const bool mine = !options.unit || unit == *options.unit || unit == 0 || unit == 255;
  Pdu answer;
  switch (carry_out({frame + kHeader, size - kHeader}, mine ? Exception::none : Exception::gateway_target,
                    answer)) {
    case Outcome::malformed:
      return false;
    case Outcome::silence:
      return !options.silence_closes;
    case Outcome::answer:
      break;
  }
  std::array<std::uint8_t, kMaxTcpFrame> out{};
  std::copy_n(frame, kHeader, out.begin());  // transaction, protocol and unit are those of the request
  store_be(out, 4, static_cast<std::uint16_t>(answer.size + 1));
  std::copy_n(answer.bytes.begin(), answer.size, out.begin() + kHeader);
  const auto n = ::send(c.descriptor, out.data(), kHeader + answer.size, MSG_NOSIGNAL | MSG_DONTWAIT);
  return n == static_cast<ssize_t>(kHeader + answer.size);  // a client that does not take its answers goes
}

/// Serves what has come in whole. False when the connection is to be closed.
bool Server::Loop::serve_tcp(Client& c, MonotonicTime& wake_at) {
  std::size_t at = 0;
  bool keep = true;
  while (keep && c.size - at >= kLengthEnd) {
    const auto* frame = c.data.data() + at;
    const std::size_t length = load_be<std::uint16_t>(c.data, at + 4);
    if (load_be<std::uint16_t>(c.data, at + 2) != 0 || length < 2 || kLengthEnd + length > kMaxTcpFrame) {
      counters.malformed.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    if (c.size - at < kLengthEnd + length) break;
    const Duration delay = faults.delay(now());
    // The sockets of virtual time know no delay: what it does to the stamps is the channel's to say.
    if (delay.ns() > 0 && !options.silence_closes && monotonic_now() - c.frame_since < delay) {
      sooner(wake_at, c.frame_since + delay);
      c.last_heard = std::max(c.last_heard, c.frame_since);
      break;
    }
    c.heard = true;
    c.last_heard = monotonic_now();
    keep = answer_tcp(c, frame, kLengthEnd + length);
    at += kLengthEnd + length;
    c.frame_since = monotonic_now();
  }
  std::memmove(c.data.data(), c.data.data() + at, c.size - at);
  c.size -= at;
  return keep;
}

bool Server::Loop::answer_rtu(Client& c) {
  const std::span<const std::uint8_t> frame(c.request.data(), c.request_size);
  c.request_size = 0;
  const std::uint8_t unit = frame[0];
  if (unit != options.unit.value_or(1) && unit != 0) {
    counters.other_units.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  c.heard = true;
  c.last_heard = monotonic_now();
  const auto request = frame.subspan(1);
  if (unit == 0) {
    // For all units of the line: nobody answers, and nobody is asked anything.
    Pdu none;
    counters.broadcasts.fetch_add(1, std::memory_order_relaxed);
    if (request[0] >= 5) (void)carry_out(request, Exception::none, none);
    return true;
  }
  Pdu answer;
  const auto outcome = carry_out(request, Exception::none, answer);
  if (outcome != Outcome::answer) return !options.silence_closes;
  c.answer[0] = unit;
  std::copy_n(answer.bytes.begin(), answer.size, c.answer.begin() + 1);
  c.answer_size = seal_frame(c.answer, answer.size + 1);
  c.answer_due = monotonic_now();
  if (c.line.paced)
    c.answer_due = c.answer_due + c.line.times.character * static_cast<std::int64_t>(c.answer_size);
  return true;
}

/// One request at a time: found, waited for, carried out, waited for, answered.
bool Server::Loop::serve_rtu(Client& c, MonotonicTime& wake_at) {
  while (true) {
    const auto t = monotonic_now();
    if (c.answer_size > 0) {
      if (t < c.answer_due) return sooner(wake_at, c.answer_due), true;
      const auto n = ::write(c.descriptor, c.answer.data(), c.answer_size);
      if (n != static_cast<ssize_t>(c.answer_size)) {
        // Nobody reads the other end: the answer is lost, as it is on a wire.
        counters.dropped.fetch_add(1, std::memory_order_relaxed);
        if (n < 0 && errno != EAGAIN && errno != EINTR) return false;
      }
      c.answer_size = 0;
    }
    if (c.request_size > 0) {
      if (t < c.request_due) return sooner(wake_at, c.request_due), true;
      if (!answer_rtu(c)) return false;
      continue;
    }
    std::span<const std::uint8_t> frame;
    const auto since = c.framer.since();
    switch (c.framer.next(t, frame)) {
      case RtuFramer::Found::nothing:
        sooner(wake_at, c.framer.due());
        return true;
      case RtuFramer::Found::garbage:
        counters.malformed.fetch_add(1, std::memory_order_relaxed);
        if (options.silence_closes) return false;
        continue;
      case RtuFramer::Found::frame:
        std::copy(frame.begin(), frame.end(), c.request.begin());
        c.request_size = frame.size();
        c.request_due = t + (options.silence_closes ? Duration(0) : faults.delay(now()));
        if (c.line.paced)
          c.request_due = std::max(
              c.request_due, since + c.line.times.character * static_cast<std::int64_t>(frame.size() + 2) +
                                 c.line.times.gap);
    }
  }
}

bool Server::Loop::serve(Client& c, MonotonicTime& wake_at) {
  return c.framing == Framing::tcp ? serve_tcp(c, wake_at) : serve_rtu(c, wake_at);
}

bool Server::Loop::receive(Client& c) {
  std::array<std::uint8_t, kMaxRtuFrame> lump;
  const bool tcp = c.framing == Framing::tcp;
  const auto n = tcp ? ::recv(c.descriptor, c.data.data() + c.size, c.data.size() - c.size, MSG_DONTWAIT)
                     : ::read(c.descriptor, lump.data(), lump.size());
  if (n == 0) return false;
  if (n < 0) return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
  const auto arrived = monotonic_now();
  if (!tcp) {
    if (!c.framer.add({lump.data(), static_cast<std::size_t>(n)}, arrived))
      counters.malformed.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  if (c.size == 0) c.frame_since = arrived;
  c.size += static_cast<std::size_t>(n);
  return true;
}

void Server::Loop::accept_one() {
  FileDescriptor socket = network::accept_tcp(listener).socket;
  if (!socket) return;
  if (clients.size() >= options.max_clients) {
    counters.turned_away.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  clients.emplace_back(std::move(socket), Framing::tcp);
  count_clients();
}

void Server::Loop::count_clients() {
  const auto n = static_cast<std::uint32_t>(std::count_if(
      clients.begin(), clients.end(), [](const Client& c) { return c.framing == Framing::tcp || c.heard; }));
  if (counters.clients.exchange(n, std::memory_order_acq_rel) != n && tell) tell(n);
}

void Server::Loop::run() {
  ask_for_time_slice(kShortTimeSlice);
  std::vector<pollfd> fds;
  auto wake_at = MonotonicTime::never();
  while (!stopping.load(std::memory_order_acquire)) {
    fds.clear();
    fds.push_back({wake.get(), POLLIN, 0});
    fds.push_back({listener.get(), POLLIN, 0});  // a negative one is ignored
    for (const auto& c : clients) {
      // A full buffer is read no further until its requests are answered.
      const bool room = c.framing == Framing::tcp ? c.size < c.data.size() : c.request_size == 0;
      fds.push_back({c.descriptor, static_cast<short>(room ? POLLIN : 0), 0});
      if (options.idle_limit.ns() > 0 && c.heard) sooner(wake_at, c.last_heard + options.idle_limit);
      if (options.idle_limit.ns() > 0 && c.framing == Framing::tcp)
        sooner(wake_at, c.last_heard + options.idle_limit);
    }
    const auto left = std::max<std::int64_t>((wake_at - monotonic_now()).ns(), 0);
    const timespec limit{left / 1'000'000'000, left % 1'000'000'000};
    if (::ppoll(fds.data(), fds.size(), wake_at == MonotonicTime::never() ? nullptr : &limit, nullptr) < 0 &&
        errno != EINTR)
      return;
    const auto t = monotonic_now();
    wake_at = MonotonicTime::never();
    for (std::size_t i = 0; i < clients.size(); ++i) {
      auto& c = clients[i];
      bool keep = true;
      if (fds[i + 2].revents != 0) keep = (fds[i + 2].revents & POLLIN) != 0 ? receive(c) : false;
      if (keep) keep = serve(c, wake_at);
      if (keep && options.idle_limit.ns() > 0 && t - c.last_heard >= options.idle_limit) {
        if (c.framing == Framing::tcp) keep = false;
        c.heard = false;
      }
      if (keep) continue;
      c.own.reset();
      c.descriptor = -1;
      counters.dropped.fetch_add(1, std::memory_order_relaxed);
    }
    std::erase_if(clients, [](const Client& c) { return c.descriptor < 0; });
    count_clients();
    if ((fds[1].revents & POLLIN) != 0) accept_one();
  }
}

Server::Server(std::shared_ptr<RegisterModel> model, std::function<BenchTime()> now, Options options,
               std::shared_ptr<FaultBox> faults)
    : faults_(faults ? std::move(faults) : std::make_shared<FaultBox>()),
      loop_(std::make_unique<Loop>(std::move(model), std::move(now), options, counters_, *faults_)) {}

Server::~Server() { stop(); }

Status Server::listen(const std::string& address, std::uint16_t port) {
  auto made = network::listen_tcp(address, port, "Modbus");
  if (!made) return tl::unexpected<Error>(made.error());
  loop_->listener = std::move(made->socket);
  port_ = made->port;
  return {};
}

void Server::on_clients(std::function<void(unsigned)> tell) { loop_->tell = std::move(tell); }

void Server::adopt(int socket, Framing framing) {
  // Nothing is ever torn in memory: a frame is there with its last byte, whatever the line's silence would
  // be.
  loop_->clients.emplace_back(FileDescriptor(socket), framing);
  if (framing == Framing::tcp) counters_.clients.fetch_add(1, std::memory_order_acq_rel);
}

void Server::serve_line(int descriptor, const Line& line) {
  loop_->clients.emplace_back(descriptor, Framing::rtu, line);
}

Status Server::start() {
  auto& l = *loop_;
  l.wake.reset(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!l.wake)
    return fail(ErrorCode::io, "", std::string("cannot start a Modbus server: ") + std::strerror(errno));
  l.faults.begin(l.now());
  l.stopping.store(false, std::memory_order_release);
  thread_ = std::thread([&l] { l.run(); });
  return {};
}

void Server::stop() {
  if (!thread_.joinable()) return;
  loop_->stopping.store(true, std::memory_order_release);
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto n = ::write(loop_->wake.get(), &one, sizeof one);
  thread_.join();
  loop_->close_all();
  counters_.clients.store(0, std::memory_order_release);
}

}  // namespace rigor::modbus
