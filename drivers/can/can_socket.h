// Sockets of the kernel's CAN protocols (linux/can/raw.h, linux/can/bcm.h, linux/can/isotp.h;
// Documentation/networking/can.rst).
//
// Raw: frames with the stamps of the kernel and of the interface (SO_TIMESTAMPING), and the kernel's own
// count of frames that the socket had no room for. A frame that this host sent comes back when it has left:
// its stamps are those of its transmission. Broadcast manager: cyclic sending that goes on in the kernel
// between two commands. ISO-TP: messages.
//
// A call returns 0 or a negative errno where it is made by I/O threads; opening returns a Status with what to
// do. One thread at a time.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/can/can_bits.h"
#include "drivers/can/frame_clock.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

struct ReceivedFrame {
  CanFrame frame;
  FrameStamps stamps;
  BenchTime read;             ///< when it was read (CLOCK_MONOTONIC)
  RealtimeTime t;             ///< for logs: the kernel's stamp, or else the instant of reading
  std::uint8_t fd_flags = 0;  ///< as the kernel gave them
  bool own = false;           ///< a program of this host sent it
};

struct RawOptions {
  std::vector<Filter> filters;  ///< none: all frames
  bool fd = false, errors = false;
  bool receive = true;           ///< false: for sending alone
  int receive_buffer_bytes = 0;  ///< 0: the system's
};

class RawSocket {
 public:
  static constexpr std::size_t kBatch = 32;

  /// not_found (no such interface, with the command that makes one), unavailable (no PF_CAN), io.
  [[nodiscard]] Status open(const std::string& interface, const RawOptions& options);
  void close() noexcept { socket_.reset(); }
  [[nodiscard]] bool is_open() const noexcept { return socket_.is_open(); }
  [[nodiscard]] int fd() const noexcept { return socket_.get(); }
  /// Frames that are there, without waiting: their count, 0 when there is none, or -errno (ENETDOWN: the
  /// interface was set down; ENODEV: it is gone).
  [[nodiscard]] int receive(std::span<ReceivedFrame> out) noexcept;
  /// 0 or -errno (ENOBUFS: the interface's queue is full).
  [[nodiscard]] int send(const CanFrame& frame) noexcept;
  /// What the kernel has to say of the interface: 0, -ENETDOWN, -ENODEV.
  [[nodiscard]] int pending_error() noexcept;
  /// Frames that this socket had no room for since it was opened.
  [[nodiscard]] std::uint64_t dropped() const noexcept;

 private:
  FileDescriptor socket_;
};

/// Cyclic sending by the kernel; each identifier has one task. Tasks end with the socket.
class BroadcastManager {
 public:
  [[nodiscard]] Status open(const std::string& interface);
  void close() noexcept { socket_.reset(); }
  [[nodiscard]] bool is_open() const noexcept { return socket_.is_open(); }
  /// Begins to send `frame` every `period`, at once and then on; or gives the task that exists a new period.
  [[nodiscard]] int start(const CanFrame& frame, Duration period) noexcept;
  /// New content of a task; its rhythm stays. `announce`: it also leaves at once.
  [[nodiscard]] int update(const CanFrame& frame, bool announce) noexcept;
  [[nodiscard]] int send_once(const CanFrame& frame) noexcept;
  /// What the kernel has to say of the interface: 0, -ENETDOWN, -ENODEV.
  [[nodiscard]] int pending_error() noexcept;

 private:
  [[nodiscard]] int write(std::uint32_t opcode, std::uint32_t flags, Duration period,
                          const CanFrame& frame) noexcept;
  FileDescriptor socket_;
};

/// ISO 15765-2 by the kernel: write a message, read a message. See isotp_codec.h for virtual time.
class IsoTpSocket {
 public:
  struct Options {
    std::uint32_t tx_id = 0, rx_id = 0;
    bool extended = false;
    bool fd = false;  ///< frames of up to 64 bytes
    std::uint8_t block_size = 0, separation = 0;
    std::optional<std::uint8_t> padding;
    std::optional<std::uint8_t> extended_address;
  };
  /// unavailable with `sudo modprobe can-isotp`, not_found, io.
  [[nodiscard]] Status open(const std::string& interface, const Options& options);
  void close() noexcept { socket_.reset(); }
  [[nodiscard]] int fd() const noexcept { return socket_.get(); }
  /// Returns when the other side has taken all of it. timeout, protocol, io.
  [[nodiscard]] Status send(std::span<const std::uint8_t> message);
  /// The next message. timeout; protocol when the other side broke off.
  [[nodiscard]] Result<std::vector<std::uint8_t>> receive(Duration timeout);
  /// Both: a request and the answer to it.
  [[nodiscard]] Result<std::vector<std::uint8_t>> request(std::span<const std::uint8_t> message,
                                                          Duration timeout);

 private:
  FileDescriptor socket_;
  std::string interface_;
};

}  // namespace rigor::can
