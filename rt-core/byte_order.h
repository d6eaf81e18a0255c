// Numbers in packets, registers and files, in either byte order. Header only; no allocation but that of the
// caller's container; any thread.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <ranges>
#include <type_traits>

namespace rigor {

/// Bytes in one piece: span, vector, array or string of std::uint8_t, std::byte or char.
template <class R>
concept ByteRange = std::ranges::contiguous_range<R> && std::ranges::sized_range<R> &&
                    sizeof(std::ranges::range_value_t<R>) == 1;

/// What is carried: integers, enumerations, float and double.
template <class T>
concept Wire = std::is_trivially_copyable_v<T> &&
               (sizeof(T) == 1 || sizeof(T) == 2 || sizeof(T) == 4 || sizeof(T) == 8) &&
               (std::is_arithmetic_v<T> || std::is_enum_v<T>);

namespace byte_order_detail {
template <std::size_t kSize>
using Unsigned =
    std::conditional_t<kSize == 1, std::uint8_t,
                       std::conditional_t<kSize == 2, std::uint16_t,
                                          std::conditional_t<kSize == 4, std::uint32_t, std::uint64_t>>>;

/// Swapped where this machine's order is another. The compiler makes one instruction of it.
template <std::endian kOrder, class U>
[[nodiscard]] U in_order(U v) noexcept {
  if constexpr (kOrder == std::endian::native || sizeof(U) == 1) return v;
  if constexpr (sizeof(U) == 2) return __builtin_bswap16(v);
  if constexpr (sizeof(U) == 4) return __builtin_bswap32(v);
  if constexpr (sizeof(U) == 8) return __builtin_bswap64(v);
}
}  // namespace byte_order_detail

/// The value whose bytes begin at `at`, in the order that is named. Precondition, which a parser checks once
/// by the length of its message: `at + sizeof(T) <= size(bytes)`.
template <Wire T, std::endian kOrder, ByteRange R>
[[nodiscard]] constexpr T load(const R& bytes, std::size_t at) noexcept {
  using U = byte_order_detail::Unsigned<sizeof(T)>;
  const auto* p = std::ranges::data(bytes) + at;
  if (!std::is_constant_evaluated()) {
    U raw;
    std::memcpy(&raw, p, sizeof raw);
    return std::bit_cast<T>(byte_order_detail::in_order<kOrder>(raw));
  }
  std::uint64_t v = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    const std::size_t from = kOrder == std::endian::big ? i : sizeof(T) - 1 - i;
    v = v << 8 | static_cast<std::uint8_t>(p[from]);
  }
  return std::bit_cast<T>(static_cast<U>(v));
}
template <Wire T, ByteRange R>
[[nodiscard]] constexpr T load_be(const R& bytes, std::size_t at = 0) noexcept {
  return load<T, std::endian::big>(bytes, at);
}
template <Wire T, ByteRange R>
[[nodiscard]] constexpr T load_le(const R& bytes, std::size_t at = 0) noexcept {
  return load<T, std::endian::little>(bytes, at);
}

/// Writes a value over the bytes that begin at `at`. Precondition: `at + sizeof(T) <= size(bytes)`.
template <std::endian kOrder, Wire T, ByteRange R>
constexpr void store(R&& bytes, std::size_t at, T value) noexcept {
  using Byte = std::ranges::range_value_t<R>;
  const auto v = std::bit_cast<byte_order_detail::Unsigned<sizeof(T)>>(value);
  auto* p = std::ranges::data(bytes) + at;
  if (!std::is_constant_evaluated()) {
    const auto raw = byte_order_detail::in_order<kOrder>(v);
    std::memcpy(p, &raw, sizeof raw);
    return;
  }
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    const std::size_t to = kOrder == std::endian::big ? sizeof(T) - 1 - i : i;
    p[to] = static_cast<Byte>(static_cast<std::uint8_t>(static_cast<std::uint64_t>(v) >> 8 * i));
  }
}
template <Wire T, ByteRange R>
constexpr void store_be(R&& bytes, std::size_t at, T value) noexcept {
  store<std::endian::big>(bytes, at, value);
}
template <Wire T, ByteRange R>
constexpr void store_le(R&& bytes, std::size_t at, T value) noexcept {
  store<std::endian::little>(bytes, at, value);
}

/// Adds a value to the end of a growing container of bytes.
template <Wire T, class Container>
constexpr void append_be(Container& out, T value) {
  const std::size_t at = out.size();
  out.resize(at + sizeof(T));
  store_be(out, at, value);
}
template <Wire T, class Container>
constexpr void append_le(Container& out, T value) {
  const std::size_t at = out.size();
  out.resize(at + sizeof(T));
  store_le(out, at, value);
}

}  // namespace rigor
