// Modbus RTU: checksums, the times of a serial line, and how a stream of bytes falls into frames. From
// "MODBUS over Serial Line Specification and Implementation Guide V1.02" (modbus.org), section 2.5.1.
//
// A frame is unit, request or answer, CRC (low byte first); frames are told apart by silences of at least 3.5
// characters. A pseudo-terminal or a USB adapter hands bytes over in lumps, so silence alone does not tell
// everything: bytes that are no frame by their checksum yet are waited for a while longer, and two requests
// that came in one lump are parted by their lengths.
//
//   framer.add(bytes, now);
//   while (framer.next(now, frame) == RtuFramer::Found::frame) …   // the frame with its unit, without its
//   CRC wait until framer.due()
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "rt-core/time.h"

namespace rigor::modbus {

inline constexpr std::size_t kMaxRtuFrame = 256;

[[nodiscard]] std::uint16_t crc16(std::span<const std::uint8_t> bytes) noexcept;

/// Times on a line of this many bits a second; a character is 11 bits as the specification has it (start,
/// eight data bits, parity or a second stop bit, stop), less where the line is set up otherwise.
struct LineTimes {
  Duration character, gap;  ///< gap: 3.5 characters; 1.75 ms above 19200 baud
  [[nodiscard]] static LineTimes of(unsigned baud, unsigned bits_per_character) noexcept;
};

class RtuFramer {
 public:
  enum class Found : std::uint8_t {
    nothing,  ///< not yet
    frame,
    garbage  ///< bytes that were no frame are gone
  };
  /// `gap`: silence that ends a frame. Incomplete bytes are dropped after `timeout` of silence. A gap of 0
  /// takes each frame as soon as its length is there (a line in memory, where nothing is ever torn).
  explicit RtuFramer(Duration gap, Duration timeout) noexcept : gap_(gap), timeout_(timeout) {}

  /// False where there is no room for them: the line is not making sense; everything is dropped.
  bool add(std::span<const std::uint8_t> bytes, MonotonicTime now) noexcept;
  /// `frame`: unit and PDU; valid until the next call.
  [[nodiscard]] Found next(MonotonicTime now, std::span<const std::uint8_t>& frame) noexcept;
  /// When `next` may know more without further bytes; never() when there is nothing to wait for.
  [[nodiscard]] MonotonicTime due() const noexcept { return due_; }
  /// When the first byte of what is waiting came.
  [[nodiscard]] MonotonicTime since() const noexcept { return since_; }

 private:
  void consume(std::size_t n) noexcept;
  [[nodiscard]] bool whole(std::size_t size) const noexcept;

  Duration gap_, timeout_;
  std::array<std::uint8_t, 4 * kMaxRtuFrame> data_{};
  std::size_t size_ = 0, taken_ = 0;
  MonotonicTime since_, heard_, due_ = MonotonicTime::never();
};

/// Adds the checksum behind `size` bytes of unit and PDU; `frame` has two more. Returns the new size.
[[nodiscard]] std::size_t seal_frame(std::span<std::uint8_t> frame, std::size_t size) noexcept;

}  // namespace rigor::modbus
