// UTF-8, a character at a time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

namespace rigor::world::store {

struct Character {
  std::uint32_t code = 0;
  std::size_t bytes = 0;  ///< 0: the text does not begin with a character (overlong, surrogate, cut short)
};

[[nodiscard]] inline Character first_character(std::string_view s) noexcept {
  if (s.empty()) return {};
  const auto byte = [&](std::size_t i) -> std::uint32_t { return static_cast<unsigned char>(s[i]); };
  const auto b0 = byte(0);
  if (b0 < 0x80) return {b0, 1};
  const std::size_t n = b0 >= 0xC2 && b0 <= 0xDF   ? 2
                        : b0 >= 0xE0 && b0 <= 0xEF ? 3
                        : b0 >= 0xF0 && b0 <= 0xF4 ? 4
                                                   : 0;
  if (n == 0 || s.size() < n) return {};
  std::uint32_t code = b0 & (0x7FU >> n);
  for (std::size_t i = 1; i < n; ++i) {
    if ((byte(i) & 0xC0U) != 0x80U) return {};
    code = code << 6 | (byte(i) & 0x3FU);
  }
  if ((n == 3 && code < 0x800) || (n == 4 && (code < 0x10000 || code > 0x10FFFF)) ||
      (code >= 0xD800 && code <= 0xDFFF))
    return {};
  return {code, n};
}

[[nodiscard]] inline bool is_utf8(std::string_view s) noexcept {
  while (!s.empty()) {
    const auto c = first_character(s);
    if (c.bytes == 0) return false;
    s.remove_prefix(c.bytes);
  }
  return true;
}

}  // namespace rigor::world::store
