// Big-endian loads and stores on byte spans, as every GigE Vision packet and register needs them. The caller
// has checked the length; each function asserts nothing and allocates nothing. Any thread.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

namespace rigor::gige {

using Bytes = std::span<const std::uint8_t>;
using MutableBytes = std::span<std::uint8_t>;

template <class U>
[[nodiscard]] constexpr U load_be(Bytes b, std::size_t at) noexcept {
  U v = 0;
  for (std::size_t i = 0; i < sizeof(U); ++i) v = static_cast<U>((v << 8) | b[at + i]);
  return v;
}
template <>
[[nodiscard]] constexpr std::uint8_t load_be<std::uint8_t>(Bytes b, std::size_t at) noexcept {
  return b[at];
}

template <class U>
constexpr void store_be(MutableBytes b, std::size_t at, U v) noexcept {
  for (std::size_t i = 0; i < sizeof(U); ++i) {
    b[at + i] = static_cast<std::uint8_t>(v >> (8 * (sizeof(U) - 1 - i)));
  }
}

[[nodiscard]] inline double load_be_double(Bytes b, std::size_t at) noexcept {
  return std::bit_cast<double>(load_be<std::uint64_t>(b, at));
}
inline void store_be_double(MutableBytes b, std::size_t at, double v) noexcept {
  store_be(b, at, std::bit_cast<std::uint64_t>(v));
}

}  // namespace rigor::gige
