// Configuration files and overrides: no input may crash the reader, every refusal has a place, and what was
// accepted reads as the same values after a dump.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "sensor-hal/config/yaml.h"

using namespace rigor;

namespace {

/// Reads everything in the way its shape suggests, and a few ways that it does not.
void visit(const ConfigNode& n, int depth) {
  if (depth > 20) return;
  for (const auto& key : n.keys()) {
    (void)catch_config([&] { return n.number(key, {.min = 0}); });
    (void)catch_config([&] { return n.integer(key); });
    (void)catch_config([&] { return n.flag(key); });
    (void)catch_config([&] { return n.text(key).size(); });
    (void)catch_config([&] { return n.choice(key, {"left", "right"}).size(); });
    (void)catch_config([&] { return n.numbers(key, 3).size(); });
    (void)catch_config([&] {
      visit(n.map_or_absent(key), depth + 1);
      return 0;
    });
    (void)catch_config([&] {
      for (const auto& item : n.list_or_empty(key)) visit(item, depth + 1);
      return 0;
    });
  }
  (void)catch_config([&] {
    n.finish();
    return 0;
  });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  // A first line of `--set …` is an override.
  std::vector<ConfigOverride> overrides;
  if (text.starts_with("--set ")) {
    const auto end = std::min(text.find('\n'), text.size());
    if (auto o = ConfigOverride::parse(text.substr(6, end - 6))) overrides.push_back(*o);
    text.remove_prefix(end);
  }
  const auto root = ConfigDocument::parse(text, "f", overrides);
  if (!root) {
    if (root.error().where.empty() || root.error().message.empty()) std::abort();
    return 0;
  }
  const auto dump = root->dump();
  const auto again = ConfigDocument::parse(dump, "dump");
  if (!again || again->dump() != dump) std::abort();
  visit(*root, 0);
  return 0;
}
