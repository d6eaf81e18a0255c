#include "drivers/can/can_bits.h"

namespace rigor::can {
namespace {

/// Counts bits as they go out, with a stuff bit after five equal ones, and keeps the CRC-15 of what it saw.
class BitCounter {
 public:
  void put(std::uint32_t value, int bits) noexcept {
    for (int i = bits - 1; i >= 0; --i) put_bit((value >> i & 1u) != 0);
  }
  void put_crc() noexcept { put(crc_, 15); }
  [[nodiscard]] unsigned bits() const noexcept { return bits_; }

 private:
  void put_bit(bool bit) noexcept {
    crc(bit);
    ++bits_;
    run_ = bit == last_ ? run_ + 1 : 1;
    last_ = bit;
    if (run_ < 5) return;
    ++bits_;  // the stuff bit, which begins the next run
    last_ = !bit;
    run_ = 1;
  }
  void crc(bool bit) noexcept {  // x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, ISO 11898-1, 10.4.2.6
    const bool next = bit != ((crc_ & 0x4000) != 0);
    crc_ = static_cast<std::uint16_t>(crc_ << 1 & 0x7fff);
    if (next) crc_ ^= 0x4599;
  }
  unsigned bits_ = 0, run_ = 0;
  bool last_ = true;  // the bus is recessive before a frame
  std::uint16_t crc_ = 0;
};

std::uint32_t length_code(std::uint8_t length) noexcept {
  constexpr std::uint8_t kLengths[] = {12, 16, 20, 24, 32, 48, 64};
  if (length <= 8) return length;
  for (std::uint32_t i = 0; i < 7; ++i)
    if (length <= kLengths[i]) return 9 + i;
  return 15;
}

// After the CRC sequence: its delimiter, acknowledge slot and delimiter, end of frame; then the intermission.
constexpr unsigned kAfterCrc = 1 + 1 + 1 + 7, kIntermission = 3;

void put_identifier(BitCounter& out, const CanFrame& f) noexcept {
  out.put(0, 1);  // start of frame
  if (f.extended) {
    out.put(f.id >> 18 & 0x7ff, 11);
    out.put(3, 2);  // SRR, IDE
    out.put(f.id & 0x3ffff, 18);
  } else {
    out.put(f.id & 0x7ff, 11);
  }
}

}  // namespace

std::uint64_t arbitration(const CanFrame& f) noexcept {
  const std::uint64_t rtr = f.remote ? 1 : 0;
  if (!f.extended) return std::uint64_t{f.id & kStandardMask} << 21 | rtr << 20;
  return std::uint64_t{f.id >> 18 & kStandardMask} << 21 | std::uint64_t{3} << 19 |
         std::uint64_t{f.id & 0x3ffff} << 1 | rtr;
}

unsigned classic_bits(const CanFrame& f) noexcept {
  BitCounter out;
  put_identifier(out, f);
  out.put(f.remote ? 1 : 0, 1);
  out.put(0, 2);  // IDE or r1, r0
  const std::uint8_t length = f.length <= 8 ? f.length : 8;
  out.put(length, 4);
  if (!f.remote)
    for (std::uint8_t i = 0; i < length; ++i) out.put(f.data[i], 8);
  out.put_crc();
  return out.bits() + kAfterCrc + kIntermission;
}

Duration frame_duration(const CanFrame& f, const BitRates& rates) noexcept {
  const auto time = [](unsigned bits, std::uint32_t rate) {
    return Duration((static_cast<std::int64_t>(bits) * 1'000'000'000 + rate / 2) / rate);
  };
  if (!f.fd) return time(classic_bits(f), rates.nominal);
  BitCounter out;
  put_identifier(out, f);
  out.put(0, 1);                          // r1 (RRS)
  if (!f.extended) out.put(0, 1);         // IDE
  out.put(2, 2);                          // FDF, res
  out.put(f.bit_rate_switch ? 1 : 0, 1);  // BRS
  const unsigned head = out.bits();
  out.put(0, 1);  // ESI
  const std::uint8_t length = f.length <= 64 ? fd_length(f.length) : 64;
  out.put(length_code(length), 4);
  for (std::uint8_t i = 0; i < length; ++i) out.put(f.data[i], 8);
  // Stuff count (4 bits) and CRC of 17 or 21 bits, with a fixed stuff bit first and after every fourth.
  const unsigned crc = 4 + (length <= 16 ? 17u : 21u);
  const unsigned fast = out.bits() - head + crc + (crc + 3) / 4 + (crc % 4 == 0 ? 1 : 0);
  const unsigned slow = head + kAfterCrc + kIntermission;
  return time(slow, rates.nominal) + time(fast, f.bit_rate_switch ? rates.data : rates.nominal);
}

}  // namespace rigor::can
