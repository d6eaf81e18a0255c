#include "drivers/serial/byte_link.h"

#include <poll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "drivers/network/tcp_socket.h"
#include "drivers/network/tcp_stream.h"
#include "rt-core/deadline.h"

namespace rigor::serial {
namespace {

constexpr Duration kSendLimit = milliseconds(500), kConnectLimit = milliseconds(500);

timespec until_now(MonotonicTime until) {
  const std::int64_t ns = std::clamp<std::int64_t>((until - monotonic_now()).ns(), 0, seconds(3600).ns());
  return {ns / 1'000'000'000, ns % 1'000'000'000};
}

/// What both carriers share: waits that end when the link is cut.
class CutLink : public ByteLink {
 public:
  [[nodiscard]] bool wait(MonotonicTime until) override { return deadline_.wait_until(until); }
  void cut() noexcept override { deadline_.cut(); }
  void uncut() noexcept override { deadline_.reset(); }

 protected:
  [[nodiscard]] Status ready() {
    if (deadline_.cut_fd() >= 0) return {};
    return deadline_.open();
  }
  Deadline deadline_;
};

class SerialLink final : public CutLink {
 public:
  explicit SerialLink(SerialSettings settings) : settings_(std::move(settings)) {}
  ~SerialLink() override { SerialLink::close(); }
  [[nodiscard]] std::string name() const override { return settings_.device; }
  [[nodiscard]] bool is_open() const noexcept override { return fd_.is_open(); }
  void close() noexcept override {
    // The mark stays with the terminal for as long as anybody has it open.
    if (fd_) (void)::ioctl(fd_.get(), TIOCNXCL);
    fd_.reset();
  }
  [[nodiscard]] Status open() override {
    close();
    if (auto s = ready(); !s) return s;
    auto port = open_serial(settings_, Sharing::exclusive);
    if (!port) return tl::unexpected<Error>(port.error());
    fd_ = std::move(*port);
    return {};
  }
  [[nodiscard]] bool set_baud(unsigned baud) override {
    if (!fd_ || !serial::set_baud(fd_.get(), baud)) return false;
    settings_.baud = baud;
    ::tcflush(fd_.get(), TCIFLUSH);
    return true;
  }
  [[nodiscard]] bool send(std::string_view bytes) override {
    const MonotonicTime limit = monotonic_now() + kSendLimit;
    while (!bytes.empty()) {
      const ssize_t n = ::write(fd_.get(), bytes.data(), bytes.size());
      if (n > 0) {
        bytes.remove_prefix(static_cast<std::size_t>(n));
        continue;
      }
      if (n < 0 && errno == EINTR) continue;
      if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK) return false;
      pollfd p{fd_.get(), POLLOUT, 0};
      const timespec t = until_now(limit);
      if (monotonic_now() >= limit || ::ppoll(&p, 1, &t, nullptr) < 0) return false;
    }
    return true;
  }
  [[nodiscard]] Received receive(std::span<char> into, MonotonicTime until) override {
    Received r;
    while (true) {
      pollfd p[2] = {{fd_.get(), POLLIN, 0}, {deadline_.cut_fd(), POLLIN, 0}};
      const timespec t = until_now(until);
      const int ready = ::ppoll(p, 2, &t, nullptr);
      if (ready < 0 && errno == EINTR) continue;
      if (p[1].revents != 0) {
        r.state = State::cut;
        return r;
      }
      if (ready == 0) return r;
      r.arrival = monotonic_now();
      const ssize_t n = ready < 0 ? -1 : ::read(fd_.get(), into.data(), into.size());
      if (n < 0 && (errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK)) continue;
      if (n <= 0) {
        r.state = State::gone;  // unplugged, or the far end of a pseudo-terminal was closed
        return r;
      }
      r.state = State::data;
      r.bytes = static_cast<std::size_t>(n);
      return r;
    }
  }

 private:
  SerialSettings settings_;
  FileDescriptor fd_;
};

class TcpLink final : public CutLink {
 public:
  TcpLink(std::string address, std::uint16_t port, std::string device, std::string advice)
      : address_(std::move(address)), port_(port), device_(std::move(device)), advice_(std::move(advice)) {}
  [[nodiscard]] std::string name() const override { return network::endpoint_text(address_, port_); }
  [[nodiscard]] bool is_open() const noexcept override { return stream_.is_open(); }
  void close() noexcept override { stream_.close(); }
  [[nodiscard]] Status open() override {
    close();
    if (auto s = ready(); !s) return s;
    auto s = stream_.connect(address_, port_, monotonic_now() + kConnectLimit, deadline_.cut_fd(), device_);
    if (s) return s;
    return fail(s.error().code == ErrorCode::not_found ? ErrorCode::unavailable : s.error().code, name(),
                s.error().message + advice_);
  }
  [[nodiscard]] bool send(std::string_view bytes) override {
    return stream_.send({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()},
                        monotonic_now() + kSendLimit);
  }
  [[nodiscard]] Received receive(std::span<char> into, MonotonicTime until) override {
    using Outcome = network::TcpStream::Outcome;
    Received r;
    const Outcome o =
        stream_.receive({reinterpret_cast<std::uint8_t*>(into.data()), into.size()}, until, r.bytes);
    r.arrival = monotonic_now();
    r.state = o == Outcome::data      ? State::data
              : o == Outcome::timeout ? State::timeout
              : o == Outcome::cut     ? State::cut
                                      : State::gone;
    return r;
  }

 private:
  std::string address_;
  std::uint16_t port_;
  std::string device_, advice_;
  network::TcpStream stream_;
};

}  // namespace

std::unique_ptr<ByteLink> make_serial_link(SerialSettings settings) {
  return std::make_unique<SerialLink>(std::move(settings));
}
std::unique_ptr<ByteLink> make_tcp_link(std::string address, std::uint16_t port, std::string device,
                                        std::string advice) {
  return std::make_unique<TcpLink>(std::move(address), port, std::move(device), std::move(advice));
}

}  // namespace rigor::serial
