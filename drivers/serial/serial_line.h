// Serial lines: a port of this machine with its settings, and a pseudo-terminal that other programs take for
// one. The byte stream over an open port is a ByteLink (byte_link.h).
#pragma once

#include <optional>
#include <string>

#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::serial {

/// How the driver of the port switches a transceiver between sending and receiving (TIOCSRS485).
struct Rs485 {
  bool rts_high_on_send = true;
  Duration before_send, after_send;  ///< whole milliseconds
  bool receive_own = false;          ///< what is sent is received as well

  friend bool operator==(const Rs485&, const Rs485&) = default;
};

struct SerialSettings {
  std::string device;  ///< `/dev/ttyUSB0`, or a link to one
  unsigned baud = 115200;
  char parity = 'N';  ///< N, E, O
  unsigned data_bits = 8, stop_bits = 1;
  std::optional<Rs485> rs485;

  /// What a protocol takes where the rig says nothing.
  struct Defaults {
    unsigned baud = 115200;
    char parity = 'N';
    /// Two stop bits where there is no parity: 11 bits a character, as Modbus RTU has it.
    bool two_stop_bits_without_parity = false;
    unsigned least_data_bits = 8;
    bool automatic_baud = false;  ///< `baud: auto` is taken, and read as 0: the caller finds it out
  };
  /// Reads `baud`, `parity` (none, even, odd), `data_bits`, `stop_bits`, and `rs485: { rts_on_send: high,
  /// before_send_ms, after_send_ms, receive_own }`; not `device`. Throws ConfigError.
  [[nodiscard]] static SerialSettings parse(const ConfigNode& n, const Defaults& defaults);
  /// Start bit, data, parity and stop bits.
  [[nodiscard]] unsigned bits_per_character() const noexcept {
    return 1 + data_bits + (parity == 'N' ? 0 : 1) + stop_bits;
  }
  [[nodiscard]] std::string text() const;  ///< "/dev/ttyUSB0 (19200 8E1)"

  friend bool operator==(const SerialSettings&, const SerialSettings&) = default;
};

/// Whether a line can be set to this many bits a second, and all that it can, for messages.
[[nodiscard]] bool is_standard_baud(unsigned baud) noexcept;
[[nodiscard]] std::string standard_bauds();

/// Whether others may open the port while it is open here.
enum class Sharing : std::uint8_t { shared, exclusive };

/// Opens the port raw, not blocking, with these settings, and forgets what had come before. Messages say what
/// to do: not_found (no such port), unavailable (no right, in use, no serial port, no RS-485). An exclusive
/// port is marked for the kernel (TIOCEXCL) and locked against other programs that lock (flock). Setup or I/O
/// thread.
[[nodiscard]] Result<FileDescriptor> open_serial(const SerialSettings& settings,
                                                 Sharing sharing = Sharing::shared);
/// Sets another speed on an open port. False: the driver refuses it.
[[nodiscard]] bool set_baud(int fd, unsigned baud) noexcept;
/// Bits a second that an open terminal is set to; 0 where it is none. Of the near end of a pseudo-terminal:
/// what the client at its far end has set.
[[nodiscard]] unsigned baud_of(int fd) noexcept;
/// Switches the transceiver of an open port as the settings say. unavailable: the driver knows no RS-485.
[[nodiscard]] Status set_rs485(int fd, const SerialSettings& settings);
/// Whether the path is a pseudo-terminal. It knows no parity, and to ask it for one is an error as soon as
/// nothing else changes (glibc's tcsetattr compares what it got): on such a line it is none, whatever the rig
/// says.
[[nodiscard]] bool is_pseudo_terminal(const std::string& path) noexcept;
/// What a person has to do about a port that does not open for this errno.
[[nodiscard]] std::string serial_cure(int error);

/// A pseudo-terminal under a name that stays: what is written to `line` comes out of `path`, and back. The
/// link is removed with the object.
class PseudoTerminal {
 public:
  /// `held`: the far end is kept open, so that the near end never hangs up while clients come and go.
  /// `released`: it hangs up when no client has it open, which shows whether there is one.
  enum class FarEnd : std::uint8_t { held, released };
  /// `link`: a path for clients, replaced where it is a symbolic link already and refused where it is
  /// anything else; empty: none is made, and path() is the terminal's own.
  [[nodiscard]] static Result<PseudoTerminal> open(const std::string& link, FarEnd far = FarEnd::held);
  PseudoTerminal(PseudoTerminal&&) noexcept = default;
  PseudoTerminal& operator=(PseudoTerminal&&) = delete;
  ~PseudoTerminal();

  [[nodiscard]] const std::string& path() const noexcept { return path_; }
  /// The near end; not blocking. Stays with this object.
  [[nodiscard]] int line() const noexcept { return near_.get(); }
  /// Of a released far end: whether a client has it open.
  [[nodiscard]] bool has_client() const noexcept;

 private:
  PseudoTerminal() = default;
  FileDescriptor near_, far_;
  std::string path_, name_;
  bool linked_ = false;
};

}  // namespace rigor::serial
