#include "drivers/can/signal_codec.h"

#include <bit>
#include <cmath>
#include <limits>

#include "drivers/can/can_bits.h"

namespace rigor::can {
namespace {

/// Bit after bit in the order from the most significant: Motorola runs down through a byte, then to bit 7 of
/// the next.
constexpr unsigned after(unsigned bit) noexcept { return bit % 8 == 0 ? bit + 15 : bit - 1; }

std::uint64_t mask_of(unsigned bits) noexcept {
  return bits >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
}

}  // namespace

bool within(const Signal& s, std::size_t length) noexcept {
  const std::size_t bits = length * 8;
  if (s.order == BitOrder::intel) return std::size_t{s.start_bit} + s.length_bits <= bits;
  const std::size_t sent = s.start_bit / 8u * 8u + (7u - s.start_bit % 8u);
  return sent + s.length_bits <= bits;
}

std::uint64_t read_raw(const Signal& s, std::span<const std::uint8_t> data) noexcept {
  std::uint64_t raw = 0;
  unsigned bit = s.start_bit;
  for (unsigned i = 0; i < s.length_bits; ++i) {
    const std::uint64_t value = data[bit / 8] >> (bit % 8) & 1u;
    if (s.order == BitOrder::intel) {
      raw |= value << i;
      ++bit;
    } else {
      raw = raw << 1 | value;
      bit = after(bit);
    }
  }
  return raw;
}

void write_raw(const Signal& s, std::span<std::uint8_t> data, std::uint64_t raw) noexcept {
  unsigned bit = s.start_bit;
  for (unsigned i = 0; i < s.length_bits; ++i) {
    const unsigned from = s.order == BitOrder::intel ? i : s.length_bits - 1u - i;
    const auto mask = static_cast<std::uint8_t>(1u << (bit % 8));
    auto& byte = data[bit / 8];
    byte = static_cast<std::uint8_t>((raw >> from & 1u) != 0 ? byte | mask : byte & ~mask);
    bit = s.order == BitOrder::intel ? bit + 1 : after(bit);
  }
}

double value_of(const Signal& s, std::uint64_t raw) noexcept {
  double x = 0;
  if (s.type == RawType::float32) {
    x = static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(raw)));
  } else if (s.type == RawType::float64) {
    x = std::bit_cast<double>(raw);
  } else if (s.is_signed) {
    const unsigned unused = 64u - s.length_bits;
    x = static_cast<double>(static_cast<std::int64_t>(raw << unused) >> unused);
  } else {
    x = static_cast<double>(raw);
  }
  return x * s.factor + s.offset;
}

EncodeStatus raw_of(const Signal& s, double value, std::uint64_t& raw) noexcept {
  if (!std::isfinite(value)) return EncodeStatus::not_a_number;
  const double x = (value - s.offset) / s.factor;
  std::uint64_t out = 0;
  if (s.type == RawType::float32) {
    const auto f = static_cast<float>(x);
    if (!std::isfinite(f)) return EncodeStatus::out_of_range;
    out = std::bit_cast<std::uint32_t>(f);
  } else if (s.type == RawType::float64) {
    if (!std::isfinite(x)) return EncodeStatus::out_of_range;
    out = std::bit_cast<std::uint64_t>(x);
  } else {
    const double rounded = std::round(x);
    const double top = std::ldexp(1.0, s.is_signed ? s.length_bits - 1 : s.length_bits);
    if (!(rounded < top) || rounded < (s.is_signed ? -top : 0.0)) return EncodeStatus::out_of_range;
    out = s.is_signed
              ? static_cast<std::uint64_t>(static_cast<std::int64_t>(rounded)) & mask_of(s.length_bits)
              : static_cast<std::uint64_t>(rounded);
  }
  if (s.has_range()) {
    // What will be read, not what was asked: rounding to the raw grid may not leave the range by more than
    // the arithmetic of doubles does.
    const double read = value_of(s, out);
    const double slack = 1e-9 * std::max(std::fabs(s.minimum), std::fabs(s.maximum));
    if (read < s.minimum - slack || read > s.maximum + slack) return EncodeStatus::out_of_range;
  }
  raw = out;
  return EncodeStatus::good;
}

bool is_shown(const Message& m, std::size_t signal, std::span<const std::uint8_t> data) noexcept {
  const Signal* s = &m.signals[signal];
  if (!within(*s, data.size())) return false;
  while (s->multiplexed_by >= 0) {
    const Signal& by = m.signals[static_cast<std::size_t>(s->multiplexed_by)];
    if (!within(by, data.size()) || !s->shown_by(read_raw(by, data))) return false;
    s = &by;
  }
  return true;
}

double decode(const Message& m, std::size_t signal, std::span<const std::uint8_t> data) noexcept {
  if (!is_shown(m, signal, data)) return std::numeric_limits<double>::quiet_NaN();
  return value_of(m.signals[signal], read_raw(m.signals[signal], data));
}

void decode(const Message& m, std::span<const std::uint8_t> data, std::span<double> out) noexcept {
  for (std::size_t i = 0; i < m.signals.size() && i < out.size(); ++i) out[i] = decode(m, i, data);
}

CanFrame blank_frame(const Message& m) noexcept {
  CanFrame f;
  f.id = m.id;
  f.extended = m.extended;
  f.fd = m.fd;
  f.bit_rate_switch = m.bit_rate_switch;
  f.length = m.fd ? fd_length(m.length) : static_cast<std::uint8_t>(m.length < 8 ? m.length : 8);
  for (const auto& s : m.signals) {
    if (!within(s, f.length) || s.multiplexed_by >= 0) continue;
    std::uint64_t raw = 0;
    const double value = s.start_raw * s.factor + s.offset;
    if (s.start_raw != 0 && raw_of(s, value, raw) == EncodeStatus::good) write_raw(s, f.data, raw);
  }
  return f;
}

EncodeStatus encode(const Message& m, std::span<const double> values, CanFrame& frame,
                    std::size_t& bad) noexcept {
  CanFrame out = frame;
  const std::span<std::uint8_t> data(out.data.data(), out.length);
  // Multiplexors first, from the outermost inwards, since they say what is shown; a chain has few of them.
  const std::size_t count = std::min(values.size(), m.signals.size());
  for (std::size_t depth = 0; depth <= kMostMultiplexors; ++depth) {
    bool deeper = false;
    for (std::size_t i = 0; i < count; ++i) {
      const Signal& s = m.signals[i];
      std::size_t level = 0;
      for (int by = s.multiplexed_by; by >= 0; by = m.signals[static_cast<std::size_t>(by)].multiplexed_by)
        ++level;
      if (level > depth) deeper = true;
      if (level != depth || std::isnan(values[i]) || !is_shown(m, i, data)) continue;
      std::uint64_t raw = 0;
      if (const auto status = raw_of(s, values[i], raw); status != EncodeStatus::good) {
        bad = i;
        return status;
      }
      write_raw(s, data, raw);
    }
    if (!deeper) break;
  }
  frame = out;
  return EncodeStatus::good;
}

}  // namespace rigor::can
