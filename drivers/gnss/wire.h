// Little-endian values in UBX messages. Header only.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

namespace rigor::gnss {

using Bytes = std::span<const std::uint8_t>;
using Buffer = std::vector<std::uint8_t>;

/// The value at an offset. Precondition: `at + sizeof(T) <= bytes.size()`, which each parser checks once by
/// the length of its message.
template <class T>
[[nodiscard]] T get(Bytes bytes, std::size_t at) noexcept {
  static_assert(std::endian::native == std::endian::little, "UBX is little-endian");
  T value;
  std::memcpy(&value, bytes.data() + at, sizeof value);
  return value;
}
template <class T>
void put(Buffer& out, T value) {
  const auto raw = std::bit_cast<std::array<std::uint8_t, sizeof(T)>>(value);
  out.insert(out.end(), raw.begin(), raw.end());
}
inline void put_zeros(Buffer& out, std::size_t count) { out.insert(out.end(), count, 0); }

}  // namespace rigor::gnss
