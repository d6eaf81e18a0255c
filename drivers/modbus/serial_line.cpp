#include "drivers/modbus/serial_line.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

namespace rigor::modbus {
namespace {

struct Baud {
  unsigned rate;
  speed_t code;
};
constexpr std::array<Baud, 14> kBauds{{{1200, B1200},
                                       {2400, B2400},
                                       {4800, B4800},
                                       {9600, B9600},
                                       {19200, B19200},
                                       {38400, B38400},
                                       {57600, B57600},
                                       {115200, B115200},
                                       {230400, B230400},
                                       {460800, B460800},
                                       {500000, B500000},
                                       {921600, B921600},
                                       {1000000, B1000000},
                                       {2000000, B2000000}}};

bool make_raw(int fd, const SerialSettings& s) {
  termios t{};
  if (::tcgetattr(fd, &t) != 0) return false;
  ::cfmakeraw(&t);
  t.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | PARENB | PARODD | CSIZE | CRTSCTS);
  t.c_cflag |= CLOCAL | CREAD | (s.data_bits == 7 ? CS7 : CS8);
  if (s.stop_bits == 2) t.c_cflag |= CSTOPB;
  if (s.parity != 'N') t.c_cflag |= PARENB;
  if (s.parity == 'O') t.c_cflag |= PARODD;
  t.c_cc[VMIN] = 0;
  t.c_cc[VTIME] = 0;
  for (const auto& b : kBauds)
    if (b.rate == s.baud) {
      ::cfsetispeed(&t, b.code);
      ::cfsetospeed(&t, b.code);
    }
  return ::tcsetattr(fd, TCSANOW, &t) == 0;
}

}  // namespace

bool is_pseudo_terminal(const std::string& path) noexcept {
  struct stat there {};
  constexpr unsigned kFirst = 136, kLast = 143;  // majors of UNIX 98 slaves: admin-guide/devices.txt
  return ::stat(path.c_str(), &there) == 0 && S_ISCHR(there.st_mode) && major(there.st_rdev) >= kFirst &&
         major(there.st_rdev) <= kLast;
}

SerialSettings SerialSettings::parse(const ConfigNode& n) {
  SerialSettings s;
  const auto baud = n.integer_or("baud", 19200, {.min = 1, .max = 4e6});
  bool known = false;
  std::string list;
  for (const auto& b : kBauds) {
    known |= b.rate == static_cast<unsigned>(baud);
    list += (list.empty() ? "" : ", ") + std::to_string(b.rate);
  }
  if (!known) throw n.error("baud", "expected one of " + list + ", got " + std::to_string(baud));
  s.baud = static_cast<unsigned>(baud);
  const auto parity = n.choice_or("parity", {"none", "even", "odd"}, "even");
  s.parity = parity == "none" ? 'N' : parity == "even" ? 'E' : 'O';
  s.data_bits = static_cast<unsigned>(n.integer_or("data_bits", 8, {.min = 8, .max = 8}));
  s.stop_bits =
      static_cast<unsigned>(n.integer_or("stop_bits", s.parity == 'N' ? 2 : 1, {.min = 1, .max = 2}));
  return s;
}

std::string SerialSettings::text() const {
  return device + " (" + std::to_string(baud) + " " + std::to_string(data_bits) + parity +
         std::to_string(stop_bits) + ")";
}

Descriptor& Descriptor::operator=(Descriptor&& o) noexcept {
  if (this != &o) {
    if (fd_ >= 0) ::close(fd_);
    fd_ = o.release();
  }
  return *this;
}
Descriptor::~Descriptor() {
  if (fd_ >= 0) ::close(fd_);
}
int Descriptor::release() noexcept { return std::exchange(fd_, -1); }

std::string serial_cure(int error) {
  if (error == EACCES || error == EPERM)
    return "; serial ports are for the group dialout: sudo usermod -aG dialout $USER, and log in anew";
  if (error == EBUSY) return "; another program has the port: stop it";
  if (error == ENOENT || error == ENXIO || error == ENODEV)
    return "; check `device` and that the adapter is plugged in (rigor devices lists the ports that are), or "
           "start an emulated one with `rigor emulate`";
  return "; check that `device` is a serial port";
}

Result<Descriptor> open_serial(const SerialSettings& s) {
  Descriptor fd(::open(s.device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  SerialSettings line = s;
  if (is_pseudo_terminal(s.device)) line.parity = 'N';
  if (!fd || !make_raw(fd.get(), line)) {
    const int e = errno;
    return fail(e == ENOENT || e == ENXIO || e == ENODEV ? ErrorCode::not_found : ErrorCode::unavailable,
                s.text(), std::string("cannot open the serial port: ") + std::strerror(e) + serial_cure(e));
  }
  ::tcflush(fd.get(), TCIOFLUSH);
  return fd;
}

Result<PseudoTerminal> PseudoTerminal::open(const std::string& link) {
  PseudoTerminal p;
  const auto broken = [&](const char* what) {
    return fail(ErrorCode::unavailable, link.empty() ? "pseudo-terminal" : link,
                std::string(what) + ": " + std::strerror(errno));
  };
  p.near_ = Descriptor(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK));
  std::array<char, 128> name{};
  if (!p.near_ || ::grantpt(p.near_.get()) != 0 || ::unlockpt(p.near_.get()) != 0 ||
      ::ptsname_r(p.near_.get(), name.data(), name.size()) != 0)
    return broken("cannot open a pseudo-terminal");
  p.name_ = p.path_ = name.data();
  // Held open: without it the near end reports an error whenever the last client closes.
  p.far_ = Descriptor(::open(name.data(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  SerialSettings line;
  line.parity = 'N';
  if (!p.far_ || !make_raw(p.far_.get(), line)) return broken("cannot set up a pseudo-terminal");
  if (link.empty()) return p;
  struct stat there {};
  if (::lstat(link.c_str(), &there) == 0) {
    if (!S_ISLNK(there.st_mode))
      return fail(ErrorCode::bad_input, link,
                  "expected no file or a symbolic link to replace, got a file: give another `pty`");
    ::unlink(link.c_str());
  }
  if (::symlink(name.data(), link.c_str()) != 0) return broken("cannot make a link for the pseudo-terminal");
  p.path_ = link;
  p.linked_ = true;
  return p;
}

PseudoTerminal::~PseudoTerminal() {
  if (!linked_ || !near_) return;
  // Only where it is still ours: another emulator may have taken the name.
  std::array<char, 128> target{};
  const auto n = ::readlink(path_.c_str(), target.data(), target.size() - 1);
  if (n > 0 && name_ == target.data()) ::unlink(path_.c_str());
}

}  // namespace rigor::modbus
