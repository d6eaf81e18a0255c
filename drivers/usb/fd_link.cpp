#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "drivers/usb/byte_link.h"
#include "rt-core/deadline.h"

namespace rigor::usb {
namespace {

constexpr Duration kSendLimit = milliseconds(500), kConnectLimit = milliseconds(500);

timespec until_now(MonotonicTime until) {
  const std::int64_t ns = std::clamp<std::int64_t>((until - monotonic_now()).ns(), 0, seconds(3600).ns());
  return {ns / 1'000'000'000, ns % 1'000'000'000};
}

class FdLink : public ByteLink {
 public:
  ~FdLink() override { FdLink::close(); }
  void close() noexcept override {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  [[nodiscard]] bool is_open() const noexcept override { return fd_ >= 0; }

  [[nodiscard]] bool send(std::string_view bytes) override {
    const MonotonicTime limit = monotonic_now() + kSendLimit;
    while (!bytes.empty()) {
      const ssize_t n = put(bytes);
      if (n > 0) {
        bytes.remove_prefix(static_cast<std::size_t>(n));
        continue;
      }
      if (n < 0 && errno == EINTR) continue;
      if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK) return false;
      pollfd p{fd_, POLLOUT, 0};
      const timespec t = until_now(limit);
      if (monotonic_now() >= limit || ::ppoll(&p, 1, &t, nullptr) < 0) return false;
    }
    return true;
  }

  [[nodiscard]] Received receive(std::span<char> into, MonotonicTime until) override {
    Received r;
    while (true) {
      pollfd p[2] = {{fd_, POLLIN, 0}, {deadline_.cut_fd(), POLLIN, 0}};
      const timespec t = until_now(until);
      const int ready = ::ppoll(p, 2, &t, nullptr);
      if (ready < 0 && errno == EINTR) continue;
      if (p[1].revents != 0) {
        r.state = State::cut;
        return r;
      }
      if (ready == 0) return r;
      r.arrival = monotonic_now();
      const ssize_t n = ready < 0 ? -1 : ::read(fd_, into.data(), into.size());
      if (n < 0 && (errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK)) continue;
      if (n <= 0) {
        r.state = State::gone;
        return r;
      }
      r.state = State::data;
      r.bytes = static_cast<std::size_t>(n);
      return r;
    }
  }
  [[nodiscard]] bool wait(MonotonicTime until) override { return deadline_.wait_until(until); }
  void cut() noexcept override { deadline_.cut(); }
  void uncut() noexcept override { deadline_.reset(); }

 protected:
  virtual ssize_t put(std::string_view bytes) = 0;
  [[nodiscard]] Status ready() {
    if (deadline_.cut_fd() >= 0) return {};
    return deadline_.open();
  }
  int fd_ = -1;
  Deadline deadline_;
};

speed_t speed_of(unsigned baud) {
  switch (baud) {
    case 19200:
      return B19200;
    case 38400:
      return B38400;
    case 57600:
      return B57600;
    case 500000:
      return B500000;
    default:
      return B115200;
  }
}

class TtyLink final : public FdLink {
 public:
  TtyLink(std::string device, unsigned baud) : device_(std::move(device)), baud_(baud) {}
  [[nodiscard]] std::string name() const override { return device_; }
  [[nodiscard]] Status open() override {
    close();
    if (auto s = ready(); !s) return s;
    const int fd = ::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) {
      const int error = errno;
      const std::string why = std::strerror(error);
      if (error == EACCES)
        return fail(ErrorCode::unavailable, device_,
                    "cannot open it: " + why +
                        "; add yourself to its group (mostly: sudo usermod -a -G dialout $USER, then log in "
                        "again), or install the udev rules that come with Rigor");
      return fail(
          error == ENOENT ? ErrorCode::not_found : ErrorCode::io, device_,
          "expected a terminal with a scanner behind it, cannot open it: " + why +
              (error == ENOENT ? "; plug the scanner in, or look for its name with: rigor devices" : ""));
    }
    termios t{};
    if (::tcgetattr(fd, &t) != 0) {
      ::close(fd);
      return fail(ErrorCode::bad_input, device_, "expected a terminal, got something else");
    }
    ::cfmakeraw(&t);
    t.c_cflag |= CLOCAL | CREAD;
    t.c_cflag &= ~static_cast<tcflag_t>(CRTSCTS | HUPCL);
    t.c_cc[VMIN] = 1;
    t.c_cc[VTIME] = 0;
    ::cfsetispeed(&t, speed_of(baud_));
    ::cfsetospeed(&t, speed_of(baud_));
    ::tcsetattr(fd, TCSANOW, &t);
    ::tcflush(fd, TCIOFLUSH);
    // Nobody else may read what is meant for us.
    ::ioctl(fd, TIOCEXCL);
    fd_ = fd;
    return {};
  }

 private:
  ssize_t put(std::string_view bytes) override { return ::write(fd_, bytes.data(), bytes.size()); }
  std::string device_;
  unsigned baud_;
};

class TcpLink final : public FdLink {
 public:
  TcpLink(std::string address, std::uint16_t port) : address_(std::move(address)), port_(port) {}
  [[nodiscard]] std::string name() const override {
    const bool six = address_.find(':') != std::string::npos;
    return (six ? "[" + address_ + "]" : address_) + ":" + std::to_string(port_);
  }
  [[nodiscard]] Status open() override {
    close();
    if (auto s = ready(); !s) return s;
    addrinfo hints{};
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int e = ::getaddrinfo(address_.c_str(), std::to_string(port_).c_str(), &hints, &found); e != 0)
      return fail(ErrorCode::not_found, name(),
                  std::string("expected a host name or an address, cannot resolve it: ") + ::gai_strerror(e));
    std::string why = "no address";
    for (addrinfo* a = found; a && fd_ < 0; a = a->ai_next) {
      const int fd = ::socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
      if (fd < 0) continue;
      if (connect(fd, *a, why))
        fd_ = fd;
      else
        ::close(fd);
    }
    ::freeaddrinfo(found);
    if (fd_ < 0)
      return fail(ErrorCode::unavailable, name(),
                  "expected a scanner there, cannot connect: " + why +
                      "; is it on, is this its address (Hokuyo's own is 192.168.0.10:10940), is it in the "
                      "same network?");
    const int on = 1;
    ::setsockopt(fd_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    ::setsockopt(fd_, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
    return {};
  }

 private:
  static bool connect(int fd, const addrinfo& a, std::string& why) {
    if (::connect(fd, a.ai_addr, a.ai_addrlen) == 0) return true;
    if (errno == EINPROGRESS) {
      pollfd p{fd, POLLOUT, 0};
      const timespec t{0, kConnectLimit.ns()};
      if (::ppoll(&p, 1, &t, nullptr) == 1) {
        int error = 0;
        socklen_t size = sizeof error;
        ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size);
        if (error == 0) return true;
        errno = error;
      } else {
        errno = ETIMEDOUT;
      }
    }
    why = std::strerror(errno);
    return false;
  }
  ssize_t put(std::string_view bytes) override {
    return ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  }
  std::string address_;
  std::uint16_t port_;
};

}  // namespace

std::unique_ptr<ByteLink> make_tty_link(std::string device, unsigned baud) {
  return std::make_unique<TtyLink>(std::move(device), baud);
}
std::unique_ptr<ByteLink> make_tcp_link(std::string address, std::uint16_t port) {
  return std::make_unique<TcpLink>(std::move(address), port);
}

}  // namespace rigor::usb
