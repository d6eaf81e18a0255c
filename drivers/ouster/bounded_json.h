// JSON from networks and files: what nests deeper than anything that a sensor says is refused, because values
// are copied and written by recursion.
#pragma once

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace rigor::ouster {

/// Discarded (`is_discarded()`): no JSON, or deeper than 16 levels. `why`, where it is given: which.
[[nodiscard]] inline nlohmann::json parse_bounded(std::string_view text, std::string* why = nullptr) {
  constexpr int kDeepest = 16;
  int depth = 0, deepest = 0;
  for (const char c : text) {
    depth += c == '[' || c == '{' ? 1 : c == ']' || c == '}' ? -1 : 0;
    deepest = std::max(deepest, depth);
  }
  if (deepest > kDeepest) {
    if (why) *why = "levels deeper than any sensor's";
    return nlohmann::json(nlohmann::json::value_t::discarded);
  }
  try {
    return nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception& e) {  // no JSON, or a number that no double holds
    const std::string_view what = e.what();
    const std::size_t kind_ends = what.find("] ");
    if (why)
      *why = "a " + std::string(kind_ends == std::string_view::npos ? what : what.substr(kind_ends + 2));
    return nlohmann::json(nlohmann::json::value_t::discarded);
  }
}

}  // namespace rigor::ouster
