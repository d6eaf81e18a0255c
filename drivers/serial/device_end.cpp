#include "drivers/serial/device_end.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <optional>

#include "drivers/serial/serial_line.h"

namespace rigor::serial {
namespace {

class PtyEnd final : public DeviceEnd {
 public:
  explicit PtyEnd(std::string link) : link_(std::move(link)) {}
  [[nodiscard]] Status open() override {
    auto made = PseudoTerminal::open(link_, PseudoTerminal::FarEnd::released);
    if (!made) return tl::unexpected<Error>(made.error());
    pty_.emplace(std::move(*made));
    return {};
  }
  [[nodiscard]] int fd() override { return pty_ && pty_->has_client() ? pty_->line() : -1; }
  void lost() override {}
  void await(int cut, Duration) override { pause_until_cut(cut, milliseconds(5)); }
  [[nodiscard]] std::string endpoint() const override { return pty_ ? pty_->path() : link_; }
  [[nodiscard]] unsigned client_baud() const override { return pty_ ? baud_of(pty_->line()) : 0; }

 private:
  std::string link_;
  std::optional<PseudoTerminal> pty_;
};

class TcpEnd final : public DeviceEnd {
 public:
  TcpEnd(std::string address, std::uint16_t port) : address_(std::move(address)), port_(port) {}
  ~TcpEnd() override {
    TcpEnd::lost();
    if (listener_ >= 0) ::close(listener_);
  }
  [[nodiscard]] Status open() override {
    sockaddr_storage where{};
    socklen_t size = 0;
    auto* four = reinterpret_cast<sockaddr_in*>(&where);
    auto* six = reinterpret_cast<sockaddr_in6*>(&where);
    if (::inet_pton(AF_INET, address_.c_str(), &four->sin_addr) == 1) {
      four->sin_family = AF_INET;
      four->sin_port = htons(port_);
      size = sizeof *four;
    } else if (::inet_pton(AF_INET6, address_.c_str(), &six->sin6_addr) == 1) {
      six->sin6_family = AF_INET6;
      six->sin6_port = htons(port_);
      size = sizeof *six;
    } else {
      return fail(ErrorCode::bad_input, address_, "expected an IPv4 or IPv6 address of this machine");
    }
    listener_ = ::socket(where.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const int on = 1;
    if (listener_ >= 0) ::setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    if (listener_ < 0 || ::bind(listener_, reinterpret_cast<sockaddr*>(&where), size) != 0 ||
        ::listen(listener_, 2) != 0)
      return fail(ErrorCode::unavailable, address_ + ":" + std::to_string(port_),
                  std::string("cannot serve there: ") + std::strerror(errno) +
                      (errno == EADDRINUSE ? "; give the emulator another `port`" : ""));
    size = sizeof where;
    ::getsockname(listener_, reinterpret_cast<sockaddr*>(&where), &size);
    port_ = ntohs(where.ss_family == AF_INET ? four->sin_port : six->sin6_port);
    return {};
  }
  [[nodiscard]] int fd() override { return client_; }
  void lost() override {
    if (client_ >= 0) ::close(client_);
    client_ = -1;
  }
  void await(int cut, Duration at_most) override {
    pollfd p[2] = {{listener_, POLLIN, 0}, {cut, POLLIN, 0}};
    const timespec t{at_most.ns() / 1'000'000'000, at_most.ns() % 1'000'000'000};
    if (::ppoll(p, 2, &t, nullptr) <= 0 || p[0].revents == 0) return;
    client_ = ::accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (client_ < 0) return;
    const int on = 1, idle = 10, every = 5, tries = 3;
    ::setsockopt(client_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    // A client that is half open is found out, so that the next one gets its turn.
    ::setsockopt(client_, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
    ::setsockopt(client_, IPPROTO_TCP, TCP_KEEPIDLE, &idle, sizeof idle);
    ::setsockopt(client_, IPPROTO_TCP, TCP_KEEPINTVL, &every, sizeof every);
    ::setsockopt(client_, IPPROTO_TCP, TCP_KEEPCNT, &tries, sizeof tries);
  }
  [[nodiscard]] std::string endpoint() const override {
    const bool six = address_.find(':') != std::string::npos;
    return (six ? "[" + address_ + "]" : address_) + ":" + std::to_string(port_);
  }

 private:
  std::string address_;
  std::uint16_t port_;
  int listener_ = -1, client_ = -1;
};

}  // namespace

void pause_until_cut(int cut, Duration at_most) {
  pollfd p{cut, POLLIN, 0};
  const timespec t{at_most.ns() / 1'000'000'000, at_most.ns() % 1'000'000'000};
  (void)::ppoll(&p, 1, &t, nullptr);
}

std::unique_ptr<DeviceEnd> make_pty_end(std::string link) {
  return std::make_unique<PtyEnd>(std::move(link));
}
std::unique_ptr<DeviceEnd> make_tcp_end(std::string address, std::uint16_t port) {
  return std::make_unique<TcpEnd>(std::move(address), port);
}

ssize_t put_bytes(int fd, const char* bytes, std::size_t count) noexcept {
  const ssize_t n = ::send(fd, bytes, count, MSG_NOSIGNAL);
  return n < 0 && errno == ENOTSOCK ? ::write(fd, bytes, count) : n;
}

}  // namespace rigor::serial
