#include "drivers/v4l2/device_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>

namespace rigor::v4l2 {
namespace {

constexpr std::uint32_t kBigEndian = 1u << 31;
constexpr std::size_t kListed = 12;

}  // namespace

std::string fourcc_text(std::uint32_t code) {
  std::string text;
  for (int i = 0; i < 4; ++i) {
    const auto c = static_cast<unsigned char>((code & ~kBigEndian) >> (8 * i));
    text += c >= 0x20 && c < 0x7f ? static_cast<char>(c) : '?';
  }
  while (!text.empty() && text.back() == ' ') text.pop_back();
  if ((code & kBigEndian) != 0) text += "-BE";
  return text;
}

std::optional<std::uint32_t> fourcc_from(std::string_view text) {
  std::uint32_t flag = 0;
  if (text.size() > 3 && text.ends_with("-BE")) {
    flag = kBigEndian;
    text.remove_suffix(3);
  }
  if (text.empty() || text.size() > 4) return std::nullopt;
  std::uint32_t code = 0x20202020;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    if (c < 0x20 || c >= 0x7f) return std::nullopt;
    code = (code & ~(0xFFu << (8 * i))) | static_cast<std::uint32_t>(c) << (8 * i);
  }
  return code | flag;
}

bool OfferedSize::holds(std::uint32_t width_px, std::uint32_t height_px) const {
  const auto within = [](std::uint32_t x, std::uint32_t min, std::uint32_t max, std::uint32_t step) {
    return x >= min && x <= max && (step <= 1 || (x - min) % step == 0);
  };
  return within(width_px, min_width_px, max_width_px, step_width_px) &&
         within(height_px, min_height_px, max_height_px, step_height_px);
}

const OfferedFormat* DeviceTable::format(std::uint32_t code) const {
  const auto it = std::find_if(formats.begin(), formats.end(), [&](const auto& f) { return f.code == code; });
  return it == formats.end() ? nullptr : &*it;
}

const Control* DeviceTable::control(std::uint32_t id) const {
  const auto it = std::find_if(controls.begin(), controls.end(), [&](const auto& c) { return c.id == id; });
  return it == controls.end() ? nullptr : &*it;
}

// As name2var of v4l2-ctl (v4l-utils, utils/v4l2-ctl/v4l2-ctl-common.cpp).
std::string control_key(std::string_view kernel_name) {
  std::string key;
  bool gap = false;
  for (const char c : kernel_name) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      if (gap && !key.empty()) key += '_';
      gap = false;
      key += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else {
      gap = true;
    }
  }
  return key;
}

std::string sizes_text(const OfferedFormat& format) {
  if (format.sizes.empty()) return "sizes that it does not list";
  std::string text;
  std::size_t listed = 0;
  for (const OfferedSize& s : format.sizes) {
    if (listed++ == kListed) return text + fmt::format(" and {} more", format.sizes.size() - kListed);
    if (!text.empty()) text += ", ";
    text += fmt::format("{}x{}", s.min_width_px, s.min_height_px);
    if (!s.discrete())
      text += fmt::format(" … {}x{} in steps of {}x{}", s.max_width_px, s.max_height_px, s.step_width_px,
                          s.step_height_px);
  }
  return text;
}

std::string rates_text(const OfferedSize& size) {
  if (size.intervals.empty()) return "rates that it does not list";
  if (size.continuous)
    return fmt::format("{:.4g} … {:.4g} Hz", size.intervals.back().rate_hz(),
                       size.intervals.front().rate_hz());
  std::string text;
  for (const Interval& i : size.intervals)
    text += fmt::format("{}{:.6g}", text.empty() ? "" : ", ", i.rate_hz());
  return text + " Hz";
}

std::string range_text(const Control& c) {
  switch (c.type) {
    case ControlType::boolean:
      return "true or false";
    case ControlType::button:
      return "true, to press it";
    case ControlType::menu:
    case ControlType::integer_menu: {
      std::string text = "one of ";
      for (std::size_t i = 0; i < c.items.size(); ++i)
        text += fmt::format("{}{}", i == 0 ? "" : ", ",
                            c.type == ControlType::menu ? control_key(c.items[i].name) : c.items[i].name);
      return text;
    }
    case ControlType::bitmask:
      return fmt::format("bits of {:#x}", c.maximum);
    case ControlType::integer:
    case ControlType::integer64:
      return c.step > 1 ? fmt::format("{} … {} in steps of {}", c.minimum, c.maximum, c.step)
                        : fmt::format("{} … {}", c.minimum, c.maximum);
    case ControlType::other:
      break;
  }
  return "a text or an array, which rigs cannot set";
}

}  // namespace rigor::v4l2
