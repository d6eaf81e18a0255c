// Modbus requests and their answers without any transport: what follows the unit identifier of a frame and
// stands before its checksum. From "MODBUS Application Protocol Specification V1.1b3" (modbus.org),
// section 6.
//
// Lengths, counts and addresses of a request are checked before they are used; what exists behind an address
// is the model's to say. No socket, no thread, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "rt-core/time.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::modbus {

inline constexpr std::size_t kMaxPdu = 253;
inline constexpr std::uint16_t kMaxReadRegisters = 125, kMaxReadBits = 2000;
inline constexpr std::uint16_t kMaxWriteRegisters = 123, kMaxWriteBits = 1968;

/// Exception codes (section 7).
enum class Exception : std::uint8_t {
  none = 0,
  illegal_function = 1,
  illegal_address = 2,
  illegal_value = 3,
  device_failure = 4,
  acknowledge = 5,
  busy = 6,
  memory_parity = 8,
  gateway_path = 10,
  gateway_target = 11
};
inline constexpr std::size_t kExceptionCodes = 12;
/// "illegal data address"; "exception" where the standard knows none.
[[nodiscard]] const char* exception_text(unsigned code) noexcept;

struct Pdu {
  std::array<std::uint8_t, kMaxPdu> bytes{};
  std::size_t size = 0;
  Exception exception = Exception::none;
  [[nodiscard]] std::span<const std::uint8_t> span() const noexcept { return {bytes.data(), size}; }
};

/// Carries a request out and words its answer. False: its length is not that of its function; nothing was
/// carried out and nothing is to be answered. Functions: 1 to 6, 15, 16, 22, 23; others get exception 1.
[[nodiscard]] bool serve_request(RegisterModel& model, std::span<const std::uint8_t> request, BenchTime t,
                                 Pdu& answer);
/// Words an exception to a request of at least one byte.
void refuse(std::span<const std::uint8_t> request, Exception why, Pdu& answer) noexcept;

/// How long the request is that begins so (function code first), as its first bytes say; 0 while that cannot
/// be known, or for a function that is not.
[[nodiscard]] std::size_t request_size(std::span<const std::uint8_t> begin) noexcept;

}  // namespace rigor::modbus
