// A stream of bytes to a device, whatever carries it: USB, a terminal, a socket.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "drivers/serial/serial_line.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::serial {

/// One I/O thread at a time (setup before it starts and after it has ended); `cut` from any other.
class ByteLink {
 public:
  enum class State : std::uint8_t { data, timeout, cut, gone };
  struct Received {
    State state = State::timeout;
    std::size_t bytes = 0;
    MonotonicTime arrival;  ///< when these bytes came
  };
  struct Counters {
    std::uint64_t stalls = 0, transfer_errors = 0;
  };

  virtual ~ByteLink() = default;
  /// What is missing and how to mend it is in the error.
  [[nodiscard]] virtual Status open() = 0;
  virtual void close() noexcept = 0;
  [[nodiscard]] virtual bool is_open() const noexcept = 0;
  /// All of it, within half a second; false: the device is gone.
  [[nodiscard]] virtual bool send(std::string_view bytes) = 0;
  /// Waits for bytes until `until`. After `gone` the link is to be closed.
  [[nodiscard]] virtual Received receive(std::span<char> into, MonotonicTime until) = 0;
  /// Closed: waits until `until`, or until the device may be back. False: cut.
  [[nodiscard]] virtual bool wait(MonotonicTime until) = 0;
  /// Waits end at once, and from then on.
  virtual void cut() noexcept = 0;
  virtual void uncut() noexcept = 0;
  [[nodiscard]] virtual std::string name() const = 0;  ///< for messages: "/dev/ttyACM0"
  [[nodiscard]] virtual Counters counters() const { return {}; }
  /// Of a serial line: another speed from now on. False: not open, or refused. Others: nothing to do.
  [[nodiscard]] virtual bool set_baud(unsigned baud) {
    (void)baud;
    return is_open();
  }
};

/// A terminal: a serial line, a CDC-ACM device under its kernel driver, or a pseudo-terminal. For this
/// program alone while it is open.
[[nodiscard]] std::unique_ptr<ByteLink> make_serial_link(SerialSettings settings);
/// A device with a network plug, or a server of serial ports. `device` is what a message expects there: "a
/// scanner"; `advice` what it says besides.
[[nodiscard]] std::unique_ptr<ByteLink> make_tcp_link(std::string address, std::uint16_t port,
                                                      std::string device = "a device",
                                                      std::string advice = {});

}  // namespace rigor::serial
