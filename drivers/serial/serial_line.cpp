#include "drivers/serial/serial_line.h"

#include <fcntl.h>
#include <linux/serial.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

namespace rigor::serial {
namespace {

struct Baud {
  unsigned rate;
  speed_t code;
};
/// All that Linux names from 1200 on.
constexpr std::array<Baud, 22> kBauds{
    {{1200, B1200},       {1800, B1800},       {2400, B2400},       {4800, B4800},       {9600, B9600},
     {19200, B19200},     {38400, B38400},     {57600, B57600},     {115200, B115200},   {230400, B230400},
     {460800, B460800},   {500000, B500000},   {576000, B576000},   {921600, B921600},   {1000000, B1000000},
     {1152000, B1152000}, {1500000, B1500000}, {2000000, B2000000}, {2500000, B2500000}, {3000000, B3000000},
     {3500000, B3500000}, {4000000, B4000000}}};

const Baud* find_baud(unsigned rate) noexcept {
  const auto* b = std::find_if(kBauds.begin(), kBauds.end(), [&](const Baud& x) { return x.rate == rate; });
  return b == kBauds.end() ? nullptr : b;
}

void put_speed(termios& t, unsigned rate) noexcept {
  if (const Baud* b = find_baud(rate)) {
    ::cfsetispeed(&t, b->code);
    ::cfsetospeed(&t, b->code);
  }
}

bool make_raw(int fd, const SerialSettings& s) {
  termios t{};
  if (::tcgetattr(fd, &t) != 0) return false;
  ::cfmakeraw(&t);
  t.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | PARENB | PARODD | CSIZE | CRTSCTS | HUPCL);
  t.c_cflag |= CLOCAL | CREAD | (s.data_bits == 7 ? CS7 : CS8);
  if (s.stop_bits == 2) t.c_cflag |= CSTOPB;
  if (s.parity != 'N') t.c_cflag |= PARENB;
  if (s.parity == 'O') t.c_cflag |= PARODD;
  // Of a descriptor that does not block: nothing there is EAGAIN, and a read of 0 bytes is a line that hung
  // up.
  t.c_cc[VMIN] = 1;
  t.c_cc[VTIME] = 0;
  put_speed(t, s.baud);
  if (::tcsetattr(fd, TCSANOW, &t) != 0) return false;
  // tcsetattr succeeds where any of the settings took; a driver that does not know the speed keeps the old
  // one.
  const unsigned got = baud_of(fd);
  if (got != s.baud) {
    errno = EINVAL;
    return false;
  }
  return true;
}

std::uint32_t whole_ms(Duration d) { return static_cast<std::uint32_t>(d.ns() / 1'000'000); }

}  // namespace

bool is_standard_baud(unsigned baud) noexcept { return find_baud(baud) != nullptr; }

std::string standard_bauds() {
  std::string list;
  for (const auto& b : kBauds) list += (list.empty() ? "" : ", ") + std::to_string(b.rate);
  return list;
}

bool is_pseudo_terminal(const std::string& path) noexcept {
  struct stat there {};
  constexpr unsigned kFirst = 136, kLast = 143;  // majors of UNIX 98 slaves: admin-guide/devices.txt
  return ::stat(path.c_str(), &there) == 0 && S_ISCHR(there.st_mode) && major(there.st_rdev) >= kFirst &&
         major(there.st_rdev) <= kLast;
}

SerialSettings SerialSettings::parse(const ConfigNode& n, const Defaults& defaults) {
  SerialSettings s;
  if (defaults.automatic_baud && n.scalar_or_empty("baud") == "auto") {
    (void)n.text("baud");
    s.baud = 0;
  } else {
    const auto baud = n.integer_or("baud", defaults.baud, {.min = 1, .max = 4e6});
    if (!is_standard_baud(static_cast<unsigned>(baud)))
      throw n.error("baud", "expected one of " + standard_bauds() + ", got " + std::to_string(baud));
    s.baud = static_cast<unsigned>(baud);
  }
  const std::string usual = defaults.parity == 'N' ? "none" : defaults.parity == 'E' ? "even" : "odd";
  const auto parity = n.choice_or("parity", {"none", "even", "odd"}, usual);
  s.parity = parity == "none" ? 'N' : parity == "even" ? 'E' : 'O';
  s.data_bits = static_cast<unsigned>(
      n.integer_or("data_bits", 8, {.min = static_cast<double>(defaults.least_data_bits), .max = 8}));
  const bool two = defaults.two_stop_bits_without_parity && s.parity == 'N';
  s.stop_bits = static_cast<unsigned>(n.integer_or("stop_bits", two ? 2 : 1, {.min = 1, .max = 2}));
  if (ConfigNode r = n.map_or_absent("rs485"); r.present()) {
    Rs485 line;
    line.rts_high_on_send = r.choice_or("rts_on_send", {"high", "low"}, "high") == "high";
    line.before_send = milliseconds(r.integer_or("before_send_ms", 0, {.min = 0, .max = 100}));
    line.after_send = milliseconds(r.integer_or("after_send_ms", 0, {.min = 0, .max = 100}));
    line.receive_own = r.flag_or("receive_own", false);
    r.finish();
    s.rs485 = line;
  }
  return s;
}

std::string SerialSettings::text() const {
  return device + " (" + std::to_string(baud) + " " + std::to_string(data_bits) + parity +
         std::to_string(stop_bits) + (rs485 ? ", RS-485" : "") + ")";
}

std::string serial_cure(int error) {
  if (error == EACCES || error == EPERM)
    return "; serial ports are for the group dialout: sudo usermod -aG dialout $USER, and log in anew";
  if (error == EBUSY || error == EWOULDBLOCK)
    return "; another program has the port: stop it (sudo fuser -v DEVICE names it)";
  if (error == ENOENT || error == ENXIO || error == ENODEV)
    return "; check `device` and that the adapter is plugged in (rigor devices lists the ports that are), or "
           "start an emulated one with `rigor emulate`";
  if (error == EINVAL)
    return "; its driver does not know these settings: check `baud`, `parity`, `data_bits`";
  return "; check that `device` is a serial port";
}

bool set_baud(int fd, unsigned baud) noexcept {
  termios t{};
  if (!is_standard_baud(baud) || ::tcgetattr(fd, &t) != 0) return false;
  put_speed(t, baud);
  return ::tcsetattr(fd, TCSANOW, &t) == 0 && baud_of(fd) == baud;
}

unsigned baud_of(int fd) noexcept {
  termios t{};
  if (::tcgetattr(fd, &t) != 0) return 0;
  const speed_t code = ::cfgetospeed(&t);
  for (const auto& b : kBauds)
    if (b.code == code) return b.rate;
  return 0;
}

Status set_rs485(int fd, const SerialSettings& s) {
  if (!s.rs485) return {};
  serial_rs485 line{};
  line.flags = SER_RS485_ENABLED;
  line.flags |= s.rs485->rts_high_on_send ? std::uint32_t{SER_RS485_RTS_ON_SEND}
                                          : std::uint32_t{SER_RS485_RTS_AFTER_SEND};
  if (s.rs485->receive_own) line.flags |= SER_RS485_RX_DURING_TX;
  line.delay_rts_before_send = whole_ms(s.rs485->before_send);
  line.delay_rts_after_send = whole_ms(s.rs485->after_send);
  if (::ioctl(fd, TIOCSRS485, &line) == 0) return {};
  return fail(ErrorCode::unavailable, s.text(),
              std::string("cannot switch the port to RS-485: ") + std::strerror(errno) +
                  "; its driver knows none (most USB adapters switch by themselves): leave `rs485` away");
}

Result<FileDescriptor> open_serial(const SerialSettings& s, Sharing sharing) {
  FileDescriptor fd(::open(s.device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  SerialSettings line = s;
  if (is_pseudo_terminal(s.device)) line.parity = 'N', line.data_bits = 8;
  const bool locked = fd && (sharing == Sharing::shared || ::flock(fd.get(), LOCK_EX | LOCK_NB) == 0);
  if (!locked || !make_raw(fd.get(), line)) {
    const int e = errno;
    return fail(e == ENOENT || e == ENXIO || e == ENODEV ? ErrorCode::not_found : ErrorCode::unavailable,
                s.text(),
                std::string("cannot open the serial port: ") +
                    (e == EWOULDBLOCK ? "it is locked"
                     : e == ENOTTY    ? "expected a terminal, got something else"
                                      : std::strerror(e)) +
                    serial_cure(e));
  }
  if (sharing == Sharing::exclusive) (void)::ioctl(fd.get(), TIOCEXCL);
  if (auto set = set_rs485(fd.get(), s); !set) return tl::unexpected<Error>(set.error());
  ::tcflush(fd.get(), TCIOFLUSH);
  return fd;
}

Result<PseudoTerminal> PseudoTerminal::open(const std::string& link, FarEnd far) {
  PseudoTerminal p;
  const auto broken = [&](const char* what) {
    return fail(ErrorCode::unavailable, link.empty() ? "pseudo-terminal" : link,
                std::string(what) + ": " + std::strerror(errno));
  };
  p.near_.reset(::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK));
  std::array<char, 128> name{};
  if (!p.near_ || ::grantpt(p.near_.get()) != 0 || ::unlockpt(p.near_.get()) != 0 ||
      ::ptsname_r(p.near_.get(), name.data(), name.size()) != 0)
    return broken("cannot open a pseudo-terminal");
  p.name_ = p.path_ = name.data();
  // Raw from the start. A near end whose far end was never opened does not hang up either.
  p.far_.reset(::open(name.data(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  SerialSettings line;
  line.baud = 38400;  // what Linux gives it
  if (!p.far_ || !make_raw(p.far_.get(), line)) return broken("cannot set up a pseudo-terminal");
  if (far == FarEnd::released) p.far_.reset();
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

bool PseudoTerminal::has_client() const noexcept {
  pollfd p{near_.get(), 0, 0};
  (void)::poll(&p, 1, 0);
  return (p.revents & POLLHUP) == 0;
}

PseudoTerminal::~PseudoTerminal() {
  if (!linked_ || !near_) return;
  // Only where it is still ours: another emulator may have taken the name.
  std::array<char, 128> target{};
  const auto n = ::readlink(path_.c_str(), target.data(), target.size() - 1);
  if (n > 0 && name_ == target.data()) ::unlink(path_.c_str());
}

}  // namespace rigor::serial
