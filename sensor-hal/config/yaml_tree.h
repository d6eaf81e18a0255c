// The tree behind ConfigNode: values with their places, read from YAML in one pass over the parser's events.
//
// Built from events and not from yaml-cpp's own nodes, because those keep the first of two equal keys in
// silence and lose the place of what is missing. Values are immutable once read and shared (an alias is the
// same value); an override copies the values along its path, so that it never changes what an alias shows
// elsewhere.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::config {

/// 1-based, in characters; line 0: given by `--set`.
struct Place {
  std::uint32_t line = 0, column = 0;
};

struct Value;
using ValuePtr = std::shared_ptr<const Value>;

struct Value {
  enum class Kind : std::uint8_t { null, scalar, map, list } kind = Kind::null;
  bool quoted = false;  ///< a scalar that can only be text
  Place place;
  std::string text;  ///< of a scalar
  struct Entry {
    std::string key;
    bool key_quoted = false;
    Place key_place;
    ValuePtr value;
  };
  std::vector<Entry> entries;   ///< of a map, in the order of the file
  std::vector<ValuePtr> items;  ///< of a list
  std::uint64_t weight = 1;     ///< values in it with every alias written out
  std::size_t depth = 0;        ///< maps and lists within each other, with itself, when it was read

  [[nodiscard]] const Entry* find(std::string_view key) const noexcept {
    for (const auto& e : entries)
      if (e.key == key) return &e;
    return nullptr;
  }
};

inline constexpr std::size_t kMaxFileBytes = std::size_t{16} << 20;
inline constexpr std::uint64_t kMaxValues = 1'000'000;  ///< with aliases written out
/// Maps and lists within each other, with aliases written out. Whoever reads, writes or frees a tree recurses
/// once for each; the parser's own limit of 500 knows nothing of aliases, by which 500 levels become 30 000.
inline constexpr std::size_t kMaxDepth = 64;

/// The root map of a YAML text. bad_input with `name:line:column` for whatever is not one well-formed
/// document.
[[nodiscard]] Result<ValuePtr> read_tree(std::string_view text, std::string_view name);

/// Offset of the first character that YAML text may not have (control characters, a byte-order mark that is
/// not the first), or npos. What such text means differs between parsers, and would not survive a dump.
[[nodiscard]] std::size_t find_unprintable(std::string_view text);

/// The tree with `override` applied.
[[nodiscard]] Result<ValuePtr> apply_override(const ValuePtr& root, const ConfigOverride& override);

/// "nothing", "a map", "a list of 3", `12`, `"abc"`: what came, for messages.
[[nodiscard]] std::string describe(const Value& value);

/// YAML text that reads as the same values.
[[nodiscard]] std::string write_yaml(const Value& value);

/// True for a plain scalar that YAML 1.2 reads as nothing.
[[nodiscard]] bool is_null_word(std::string_view plain) noexcept;

}  // namespace rigor::config
