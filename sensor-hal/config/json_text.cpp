#include "sensor-hal/config/json_text.h"

#include <nlohmann/json.hpp>

namespace rigor {
namespace {

/// Whether lists and objects of the text, which need not be JSON, nest deeper than `limit`.
bool nests_deeper(std::string_view text, std::size_t limit) noexcept {
  std::size_t depth = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c == '\\') ++i;
      if (c == '"') quoted = false;
    } else if (c == '"') {
      quoted = true;
    } else if (c == '[' || c == '{') {
      if (++depth > limit) return true;
    } else if ((c == ']' || c == '}') && depth > 0) {
      --depth;
    }
  }
  return false;
}

/// The beginning of what came, fit for a terminal.
std::string cited(std::string_view text) {
  constexpr std::size_t kMost = 60;
  if (text.empty()) return "nothing";
  std::string out = "\"";
  for (const char c : text.substr(0, kMost)) out += c >= 0x20 && c < 0x7f ? c : '?';
  return out + (text.size() > kMost ? "…\"" : "\"");
}

}  // namespace

Result<nlohmann::json> parse_json(std::string_view text, std::string where, std::size_t max_bytes) {
  if (text.size() > max_bytes)
    return fail(ErrorCode::bad_input, std::move(where),
                "expected at most " + std::to_string(max_bytes) + " bytes of JSON, got " +
                    std::to_string(text.size()));
  if (nests_deeper(text, kMaxJsonDepth))
    return fail(ErrorCode::bad_input, std::move(where),
                "expected JSON nested at most " + std::to_string(kMaxJsonDepth) +
                    " levels deep, got more; flatten it");
  auto value = nlohmann::json::parse(text, nullptr, false);
  if (value.is_discarded())
    return fail(ErrorCode::bad_input, std::move(where), "expected JSON, got " + cited(text));
  return value;
}

}  // namespace rigor
