// Writes into the text of an event, without the C library's formatting (which may allocate). What does not
// fit is left away.
#pragma once

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <string_view>

#include "sensor-hal/types/sample.h"

namespace rigor {

/// EventInfo::code of an edit of the bench's world while a run goes on; `value` is the node.
inline constexpr std::uint32_t kEventWorldEdit = 0x30;
/// A sink's thread wrote its safe values while a run went on, for nobody commanded it; `value` is the sink's
/// place in the rig.
inline constexpr std::uint32_t kEventMadeSafe = 0x31;

/// One thread; wait-free.
class EventText {
 public:
  explicit EventText(EventInfo& info) noexcept : text_(info.text) { text_.fill('\0'); }
  EventText& add(std::string_view s) noexcept {
    const std::size_t n = std::min(s.size(), text_.size() - 1 - at_);
    std::memcpy(text_.data() + at_, s.data(), n);
    at_ += n;
    return *this;
  }
  EventText& add(std::uint64_t n) noexcept {
    std::array<char, 20> digits{};
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), n).ptr;
    return add({digits.data(), static_cast<std::size_t>(end - digits.data())});
  }

 private:
  decltype(EventInfo::text)& text_;
  std::size_t at_ = 0;
};

}  // namespace rigor
