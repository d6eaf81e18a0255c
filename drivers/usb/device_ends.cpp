#include "drivers/usb/device_ends.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

namespace rigor::usb {
namespace {

namespace fs = std::filesystem;

void pause(int cut, Duration at_most) {
  pollfd p{cut, POLLIN, 0};
  const timespec t{at_most.ns() / 1'000'000'000, at_most.ns() % 1'000'000'000};
  (void)::ppoll(&p, 1, &t, nullptr);
}

class PtyEnd final : public DeviceEnd {
 public:
  explicit PtyEnd(std::string link) : link_(std::move(link)) {}
  ~PtyEnd() override {
    if (master_ >= 0) ::close(master_);
    std::error_code error;
    if (made_link_ && fs::is_symlink(link_, error) && fs::read_symlink(link_, error) == path_)
      fs::remove(link_, error);
  }
  [[nodiscard]] Status open() override {
    master_ = ::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    char name[128];
    if (master_ < 0 || ::grantpt(master_) != 0 || ::unlockpt(master_) != 0 ||
        ::ptsname_r(master_, name, sizeof name) != 0)
      return fail(ErrorCode::unavailable, "",
                  std::string("cannot make a pseudo-terminal: ") + std::strerror(errno));
    path_ = name;
    // Raw from the start, and once opened and closed, so that the master sees that nobody is there.
    const int slave = ::open(name, O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (slave < 0) return fail(ErrorCode::unavailable, path_, std::strerror(errno));
    termios t{};
    ::tcgetattr(slave, &t);
    ::cfmakeraw(&t);
    ::tcsetattr(slave, TCSANOW, &t);
    ::close(slave);
    if (link_.empty()) return {};
    std::error_code error;
    if (fs::is_symlink(link_, error)) fs::remove(link_, error);
    if (fs::exists(link_, error))
      return fail(ErrorCode::not_writable, link_,
                  "expected a name for a link that is free, found a file: move it away");
    fs::create_symlink(path_, link_, error);
    if (error) return fail(ErrorCode::not_writable, link_, "cannot make the link: " + error.message());
    made_link_ = true;
    return {};
  }
  [[nodiscard]] int fd() override {
    pollfd p{master_, 0, 0};
    (void)::poll(&p, 1, 0);
    return (p.revents & POLLHUP) != 0 ? -1 : master_;  // hung up: no client has it open
  }
  void lost() override {}
  void await(int cut, Duration) override { pause(cut, milliseconds(5)); }
  [[nodiscard]] std::string endpoint() const override { return link_.empty() ? path_ : link_; }

 private:
  std::string link_, path_;
  int master_ = -1;
  bool made_link_ = false;
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

class GadgetEnd final : public DeviceEnd {
 public:
  explicit GadgetEnd(GadgetSettings settings) : settings_(std::move(settings)) {}
  ~GadgetEnd() override {
    GadgetEnd::lost();
    gadget_.remove();
  }
  [[nodiscard]] Status open() override {
    if (auto s = gadget_.create(settings_); !s) return s;
    if (auto s = gadget_.bind(); !s) return s;
    auto port = gadget_.acm_port();
    if (!port) return tl::unexpected<Error>(port.error());
    device_ = "/dev/ttyGS" + std::to_string(*port);
    return {};
  }
  [[nodiscard]] int fd() override { return fd_; }
  void lost() override {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  void await(int cut, Duration) override {
    fd_ = ::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd_ < 0) return pause(cut, milliseconds(20));
    termios t{};
    ::tcgetattr(fd_, &t);
    ::cfmakeraw(&t);
    t.c_cflag |= CLOCAL;
    ::tcsetattr(fd_, TCSANOW, &t);
  }
  [[nodiscard]] std::string endpoint() const override {
    char ids[16];
    std::snprintf(ids, sizeof ids, "%04x:%04x", settings_.vendor, settings_.product);
    return std::string("USB ") + ids + " on " + gadget_.udc() + " (" + device_ + ")";
  }

 private:
  GadgetSettings settings_;
  UsbGadget gadget_;
  std::string device_;
  int fd_ = -1;
};

}  // namespace

std::unique_ptr<DeviceEnd> make_pty_end(std::string link) {
  return std::make_unique<PtyEnd>(std::move(link));
}
std::unique_ptr<DeviceEnd> make_tcp_end(std::string address, std::uint16_t port) {
  return std::make_unique<TcpEnd>(std::move(address), port);
}
std::unique_ptr<DeviceEnd> make_gadget_end(GadgetSettings settings) {
  return std::make_unique<GadgetEnd>(std::move(settings));
}

ssize_t put_bytes(int fd, const char* bytes, std::size_t count) noexcept {
  const ssize_t n = ::send(fd, bytes, count, MSG_NOSIGNAL);
  return n < 0 && errno == ENOTSOCK ? ::write(fd, bytes, count) : n;
}

}  // namespace rigor::usb
