// What the two frame formats of CAN share in numbers: which lengths a data field can have, and how long a
// frame holds the bus.
//
// Lengths: a data length code of 9 to 15 stands for 12, 16, 20, 24, 32, 48 and 64 bytes (ISO 11898-1:2015,
// table 5); a classic frame has at most 8.
#pragma once

#include <cstdint>

#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

inline constexpr std::uint32_t kStandardMask = 0x7ff, kExtendedMask = 0x1fffffff;

/// The smallest length of a CAN FD frame that holds `bytes` (0 to 64).
[[nodiscard]] constexpr std::uint8_t fd_length(std::size_t bytes) noexcept {
  constexpr std::uint8_t kLengths[] = {8, 12, 16, 20, 24, 32, 48, 64};
  if (bytes <= 8) return static_cast<std::uint8_t>(bytes);
  for (const auto length : kLengths)
    if (bytes <= length) return length;
  return 64;
}
[[nodiscard]] constexpr bool is_fd_length(std::size_t bytes) noexcept {
  return bytes <= 64 && fd_length(bytes) == bytes;
}

struct BitRates {
  std::uint32_t nominal = 500'000;  ///< bit/s
  std::uint32_t data = 2'000'000;   ///< bit/s, between BRS and the CRC delimiter of frames that switch
};

/// Which of two frames that begin at once wins the bus: that with the smaller number here. It is the order in
/// which their arbitration fields differ: 11 bits of identifier, then RTR or SRR, then IDE, then the other 18
/// bits and RTR.
[[nodiscard]] std::uint64_t arbitration(const CanFrame& frame) noexcept;

/// How long a frame holds the bus, from its start to the end of the intermission, stuff bits counted as they
/// are for its content (classic: with its CRC-15; FD: with the fixed stuff bits of its CRC field).
[[nodiscard]] Duration frame_duration(const CanFrame& frame, const BitRates& rates) noexcept;

/// Bits of a classic frame on the bus, stuff bits and intermission included.
[[nodiscard]] unsigned classic_bits(const CanFrame& frame) noexcept;

/// A receive filter as the kernel has it: `(id & mask) == (filter.id & mask)`, and of its own frame format.
struct Filter {
  std::uint32_t id = 0, mask = kExtendedMask;
  bool extended = false;
};
[[nodiscard]] inline bool passes(const Filter& f, const CanFrame& frame) noexcept {
  return frame.extended == f.extended && (frame.id & f.mask) == (f.id & f.mask);
}

}  // namespace rigor::can
