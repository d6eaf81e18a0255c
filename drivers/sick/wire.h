// Big-endian values in telegrams. Header only; no allocation but the buffer's own.
#pragma once

#include <bit>
#include <cstdint>
#include <string>
#include <string_view>

#include "drivers/sick/cola_b.h"

namespace rigor::sick {

/// Reads what is there; beyond the end everything is zero and `good` is false for good.
class WireReader {
 public:
  explicit WireReader(Bytes data) : data_(data) {}
  [[nodiscard]] bool good() const { return good_; }
  [[nodiscard]] std::size_t left() const { return data_.size() - at_; }
  [[nodiscard]] std::uint8_t u8() { return static_cast<std::uint8_t>(take(1)); }
  [[nodiscard]] std::uint16_t u16() { return static_cast<std::uint16_t>(take(2)); }
  [[nodiscard]] std::uint32_t u32() { return take(4); }
  [[nodiscard]] std::int32_t i32() { return static_cast<std::int32_t>(take(4)); }
  [[nodiscard]] float f32() { return std::bit_cast<float>(take(4)); }
  [[nodiscard]] Bytes bytes(std::size_t size) {
    if (size > left()) {
      good_ = false;
      at_ = data_.size();
      return {};
    }
    at_ += size;
    return data_.subspan(at_ - size, size);
  }
  [[nodiscard]] std::string text(std::size_t size) {
    const Bytes b = bytes(size);
    return {b.begin(), b.end()};
  }

 private:
  std::uint32_t take(std::size_t size) {
    std::uint32_t v = 0;
    for (const auto b : bytes(size)) v = v << 8 | b;
    return v;
  }
  Bytes data_;
  std::size_t at_ = 0;
  bool good_ = true;
};

inline void put_u8(Buffer& out, unsigned v) { out.push_back(static_cast<std::uint8_t>(v)); }
inline void put_u16(Buffer& out, unsigned v) {
  out.push_back(static_cast<std::uint8_t>(v >> 8));
  out.push_back(static_cast<std::uint8_t>(v));
}
inline void put_u32(Buffer& out, std::uint32_t v) {
  put_u16(out, v >> 16);
  put_u16(out, v & 0xFFFF);
}
inline void put_i32(Buffer& out, std::int32_t v) { put_u32(out, static_cast<std::uint32_t>(v)); }
inline void put_f32(Buffer& out, float v) { put_u32(out, std::bit_cast<std::uint32_t>(v)); }
inline void put_text(Buffer& out, std::string_view text) { out.insert(out.end(), text.begin(), text.end()); }

}  // namespace rigor::sick
