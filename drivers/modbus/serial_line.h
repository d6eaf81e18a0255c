// The two ends that a Modbus RTU line can have on this machine: a serial port, and a pseudo-terminal that
// looks like one to other programs.
#pragma once

#include <string>

#include "drivers/modbus/rtu_codec.h"
#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::modbus {

struct SerialSettings {
  std::string device;  ///< `/dev/ttyUSB0`, or a link to one
  unsigned baud = 19200;
  char parity = 'E';  ///< N, E, O
  unsigned data_bits = 8, stop_bits = 1;

  /// Reads `baud`, `parity` (none, even, odd), `data_bits`, `stop_bits`; not `device`. The defaults are those
  /// of the specification: 19200, even, 8, and as many stop bits as make 11 bits a character. Throws
  /// ConfigError.
  [[nodiscard]] static SerialSettings parse(const ConfigNode& n);
  [[nodiscard]] LineTimes times() const noexcept {
    return LineTimes::of(baud, 1 + data_bits + (parity == 'N' ? 0 : 1) + stop_bits);
  }
  [[nodiscard]] std::string text() const;  ///< "/dev/ttyUSB0 (19200 8E1)"
};

/// A file descriptor that closes itself.
class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  Descriptor(Descriptor&& o) noexcept : fd_(o.release()) {}
  Descriptor& operator=(Descriptor&& o) noexcept;
  ~Descriptor();
  [[nodiscard]] int get() const noexcept { return fd_; }
  [[nodiscard]] int release() noexcept;
  explicit operator bool() const noexcept { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

/// Opens the port raw, not blocking, with these settings. Messages say what to do.
[[nodiscard]] Result<Descriptor> open_serial(const SerialSettings& settings);
/// Whether the path is a pseudo-terminal. It knows no parity, and to ask it for one is an error as soon as
/// nothing else changes (glibc's tcsetattr compares what it got): on such a line it is none, whatever the rig
/// says.
[[nodiscard]] bool is_pseudo_terminal(const std::string& path) noexcept;
/// What a person has to do about a port that does not open for this errno.
[[nodiscard]] std::string serial_cure(int error);

/// A pseudo-terminal under a name that stays: what is written to `line` comes out of `path`, and back. Its
/// far end is held open, so that clients may come and go. The link is taken away with the object.
class PseudoTerminal {
 public:
  /// `link`: a path for clients, replaced where it is a symbolic link already and refused where it is
  /// anything else; empty: none is made, and path() is the terminal's own.
  [[nodiscard]] static Result<PseudoTerminal> open(const std::string& link);
  PseudoTerminal(PseudoTerminal&&) noexcept = default;
  PseudoTerminal& operator=(PseudoTerminal&&) = delete;
  ~PseudoTerminal();

  [[nodiscard]] const std::string& path() const noexcept { return path_; }
  /// The near end; not blocking. Stays with this object.
  [[nodiscard]] int line() const noexcept { return near_.get(); }

 private:
  PseudoTerminal() = default;
  Descriptor near_, far_;
  std::string path_, name_;
  bool linked_ = false;
};

}  // namespace rigor::modbus
