// A telegram's values, one after the other. Header only; no allocation but the buffer's own.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "drivers/sick/cola_b.h"
#include "rt-core/byte_order.h"

namespace rigor::sick {

/// Reads what is there; beyond the end everything is zero and `good` is false for good.
class WireReader {
 public:
  explicit WireReader(Bytes data) : data_(data) {}
  [[nodiscard]] bool good() const { return good_; }
  [[nodiscard]] std::size_t left() const { return data_.size() - at_; }
  [[nodiscard]] std::uint8_t u8() { return take<std::uint8_t>(); }
  [[nodiscard]] std::uint16_t u16() { return take<std::uint16_t>(); }
  [[nodiscard]] std::uint32_t u32() { return take<std::uint32_t>(); }
  [[nodiscard]] std::int32_t i32() { return take<std::int32_t>(); }
  [[nodiscard]] float f32() { return take<float>(); }
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
  template <class T>
  T take() {
    const Bytes b = bytes(sizeof(T));
    return b.empty() ? T{} : load_be<T>(b);
  }
  Bytes data_;
  std::size_t at_ = 0;
  bool good_ = true;
};

inline void append_text(Buffer& out, std::string_view text) {
  out.insert(out.end(), text.begin(), text.end());
}

}  // namespace rigor::sick
