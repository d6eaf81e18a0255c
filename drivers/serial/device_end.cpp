#include "drivers/serial/device_end.h"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <optional>

#include "drivers/network/tcp_socket.h"
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
  [[nodiscard]] Status open() override {
    auto made = network::listen_tcp(address_, port_, "a device");
    if (!made) return tl::unexpected<Error>(made.error());
    listener_ = std::move(made->socket);
    port_ = made->port;
    return {};
  }
  [[nodiscard]] int fd() override { return client_.get(); }
  void lost() override { client_.reset(); }
  void await(int cut, Duration at_most) override {
    if (network::wait_for_socket(listener_.get(), POLLIN, monotonic_now() + at_most, cut) == 0)
      client_ = network::accept_tcp(listener_).socket;
  }
  [[nodiscard]] std::string endpoint() const override { return network::endpoint_text(address_, port_); }

 private:
  std::string address_;
  std::uint16_t port_;
  FileDescriptor listener_, client_;
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
