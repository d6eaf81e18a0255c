// YAML to plain values, with a place for every complaint.
//
// A config struct is read once, by name, and what was not read is an error:
//
//   struct Loop { double rate_hz; Duration spin; };
//   Loop read_loop(ConfigNode n) {              // throws ConfigError
//     Loop l;
//     l.rate_hz = n.number_or("rate_hz", 1000.0, {.min = 1, .max = 20000});
//     l.spin = microseconds(n.integer_or("spin_us", 0, {.min = 0}));
//     n.finish();  // "rig.yaml:7:3: loop.spn_us: unknown key; did you mean spin_us?"
//     return l;
//   }
//
// Every message reads `file:line:column: path.to.key: expected … got …`. ConfigError is the one exception
// type of this layer; `load_*` functions of each config catch it (see `catch_config`) and return a Result.
// Setup context.
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

class ConfigError : public std::runtime_error {
 public:
  explicit ConfigError(Error error) : std::runtime_error(error.text()), error_(std::move(error)) {}
  [[nodiscard]] const Error& error() const noexcept { return error_; }

 private:
  Error error_;
};

struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
  bool exclusive_min = false;  ///< "> min" instead of "≥ min"
};

/// A value in a parsed document with its place. Cheap to copy; keeps its document alive. A default-made node
/// is absent: it reads as an empty map, so that defaults apply.
class ConfigNode {
 public:
  ConfigNode() = default;

  [[nodiscard]] bool present() const noexcept;
  [[nodiscard]] bool is_map() const;
  [[nodiscard]] bool is_list() const;
  /// Does not count as reading the key: `finish` still asks that it be read.
  [[nodiscard]] bool has(std::string_view key) const;
  /// As it is written; empty where the key is missing, or is a map or a list.
  [[nodiscard]] std::string scalar_or_empty(std::string_view key) const;
  [[nodiscard]] std::string path() const;   ///< "channels.left.real"
  [[nodiscard]] std::string place() const;  ///< "rig.yaml:12:5"
  /// Directory of the file, against which relative paths in it are meant.
  [[nodiscard]] std::filesystem::path base_dir() const;

  // Required values: throw when the key is missing, of another type, or out of range. NaN and infinity are
  // refused. Scalars are those of YAML 1.2: `true` and `false` alone are flags; 12, 0x1f and 0o17 are whole
  // numbers; text may be written without quotes even where it looks like a number. A key without a value is
  // an empty map where a map is read, and an error elsewhere.
  [[nodiscard]] std::string text(std::string_view key) const;
  [[nodiscard]] double number(std::string_view key, Range range = {}) const;
  [[nodiscard]] std::int64_t integer(std::string_view key, Range range = {}) const;
  [[nodiscard]] bool flag(std::string_view key) const;
  [[nodiscard]] ConfigNode map(std::string_view key) const;
  [[nodiscard]] std::vector<ConfigNode> list(std::string_view key) const;
  [[nodiscard]] std::vector<double> numbers(std::string_view key,
                                            std::size_t count) const;  ///< exactly `count`
  /// One of `allowed`; the message lists them and names the nearest.
  [[nodiscard]] std::string choice(std::string_view key, const std::vector<std::string>& allowed) const;

  // The same with a default for a missing key.
  [[nodiscard]] std::string text_or(std::string_view key, std::string fallback) const;
  [[nodiscard]] double number_or(std::string_view key, double fallback, Range range = {}) const;
  [[nodiscard]] std::int64_t integer_or(std::string_view key, std::int64_t fallback, Range range = {}) const;
  [[nodiscard]] bool flag_or(std::string_view key, bool fallback) const;
  [[nodiscard]] ConfigNode map_or_absent(std::string_view key) const;
  [[nodiscard]] std::vector<ConfigNode> list_or_empty(std::string_view key) const;
  /// As many as the fallback has; any number where the fallback is empty.
  [[nodiscard]] std::vector<double> numbers_or(std::string_view key, std::vector<double> fallback) const;
  [[nodiscard]] std::string choice_or(std::string_view key, const std::vector<std::string>& allowed,
                                      std::string fallback) const;

  // This node itself as a scalar (items of lists).
  [[nodiscard]] std::string as_text() const;
  [[nodiscard]] double as_number(Range range = {}) const;
  [[nodiscard]] std::int64_t as_integer(Range range = {}) const;

  /// Keys of this map in the order of the file.
  [[nodiscard]] std::vector<std::string> keys() const;
  /// Throws when the map has a key that was not asked for by any copy of this node; names the nearest that
  /// was.
  void finish() const;
  /// An error at this node or, with a key, at that key's value.
  [[nodiscard]] ConfigError error(std::string_view key, std::string_view message) const;
  /// This node as YAML text, for a recording's metadata.
  [[nodiscard]] std::string dump() const;
  /// This node as JSON text, for other programs; scalars by the core schema of YAML 1.2, an absent node as
  /// {}. Numbers that JSON cannot say (infinity) are text.
  [[nodiscard]] std::string json() const;

 private:
  friend class ConfigDocument;
  struct Impl;
  std::shared_ptr<Impl> impl_;
};

/// One `--set path.to.key=value`. The value is YAML (`[1, 2]`, `{x: 1}`, `"5"` for text); after `=` nothing
/// means empty text. Maps on the way are made; an item of a list is named by its index (`channels.0.name`)
/// and must be there; a way through a scalar is an error. Keys that contain a dot cannot be named.
struct ConfigOverride {
  std::string path, value;
  [[nodiscard]] static Result<ConfigOverride> parse(std::string_view text);
};

class ConfigDocument {
 public:
  /// not_found / bad_input with `file:line:column`. Duplicate keys, aliases that explode and files over 16
  /// MiB are refused. An override of a key that is not in the file adds it; its place is then `--set`.
  [[nodiscard]] static Result<ConfigNode> load(const std::filesystem::path& file,
                                               const std::vector<ConfigOverride>& overrides = {});
  [[nodiscard]] static Result<ConfigNode> parse(std::string_view text, std::string_view name = "<text>",
                                                const std::vector<ConfigOverride>& overrides = {});
};

/// Runs `read` and turns a ConfigError into a Result.
template <class F>
[[nodiscard]] auto catch_config(F&& read) -> Result<decltype(read())> {
  try {
    return read();
  } catch (const ConfigError& e) {
    return tl::unexpected<Error>(e.error());
  }
}

/// The candidate nearest to `word` by edit distance, or empty when none is near.
[[nodiscard]] std::string nearest(std::string_view word, const std::vector<std::string>& candidates);
/// The words, with commas between them; `none` where there are none.
[[nodiscard]] std::string joined_or_none(const std::vector<std::string>& words);

}  // namespace rigor
