#include "drivers/v4l2/control_values.h"

#include <fmt/format.h>

#include <algorithm>

namespace rigor::v4l2 {
namespace {

std::string offered(const DeviceTable& table) {
  std::string text;
  for (const Control& c : table.controls)
    if (!c.read_only && c.type != ControlType::other)
      text += fmt::format("{}{} ({})", text.empty() ? "" : ", ", c.name, range_text(c));
  return text.empty() ? "none" : text;
}

const Control& find(const ConfigNode& n, const std::string& name, const DeviceTable& table) {
  std::vector<std::string> names;
  for (const Control& c : table.controls) {
    if (c.name == name) return c;
    names.push_back(c.name);
  }
  const std::string near = nearest(name, names);
  throw n.error(name, fmt::format("expected a control of {}{}: {}; got {}", table.card,
                                  near.empty() ? "" : " (did you mean " + near + "?)", offered(table), name));
}

std::int64_t item_of(const ConfigNode& n, const Control& c, const std::string& text) {
  for (const Control::Item& i : c.items)
    if (text == i.name || (c.type == ControlType::menu && text == control_key(i.name))) return i.index;
  if (c.type == ControlType::menu)
    for (const Control::Item& i : c.items)
      if (text == std::to_string(i.index)) return i.index;
  throw n.error(c.name, fmt::format("expected {}, got {}", range_text(c), text));
}

std::int64_t value_of(const ConfigNode& n, const Control& c) {
  const std::string text = n.text(c.name);
  switch (c.type) {
    case ControlType::boolean:
    case ControlType::button:
      if (text == "0" || text == "1") return text == "1" ? 1 : 0;
      return n.flag(c.name) ? 1 : 0;
    case ControlType::menu:
    case ControlType::integer_menu:
      return item_of(n, c, text);
    case ControlType::integer:
    case ControlType::integer64:
    case ControlType::bitmask: {
      const std::int64_t v = n.integer(c.name);
      const bool in_range =
          c.type == ControlType::bitmask ? (v & ~c.maximum) == 0 : v >= c.minimum && v <= c.maximum;
      if (!in_range) throw n.error(c.name, fmt::format("expected {}, got {}", range_text(c), v));
      if (c.type != ControlType::bitmask && c.step > 1) {
        const auto off = (static_cast<std::uint64_t>(v) - static_cast<std::uint64_t>(c.minimum)) %
                         static_cast<std::uint64_t>(c.step);
        if (off != 0)
          throw n.error(c.name, fmt::format("expected {}, got {}; next below is {}", range_text(c), v,
                                            v - static_cast<std::int64_t>(off)));
      }
      return v;
    }
    case ControlType::other:
      break;
  }
  throw n.error(c.name, "expected a control with a number, a flag or a menu: texts and arrays cannot be set");
}

}  // namespace

std::vector<ControlValue> check_controls(const ConfigNode& n, const DeviceTable& table) {
  std::vector<ControlValue> values;
  if (!n.present()) return values;
  for (const std::string& name : n.keys()) {
    const Control& c = find(n, name, table);
    if (c.read_only) throw n.error(name, "expected a control that can be set: this one can only be read");
    const std::int64_t value = value_of(n, c);
    if (c.type == ControlType::button && value == 0) continue;
    values.push_back({c.id, value, c.name});
  }
  return values;
}

}  // namespace rigor::v4l2
