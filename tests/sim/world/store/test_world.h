// A world with a node type that has every kind of attribute, and a history of changes that is a function of
// its number alone.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "sim/world/graph/database.h"

namespace rigor::world::test {

/// SplitMix64: which change comes next, and its values.
class Draws {
 public:
  explicit Draws(std::uint64_t seed) : state_(seed) {}
  std::uint64_t word() {
    std::uint64_t z = state_ += 0x9E3779B97F4A7C15ULL;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ z >> 27) * 0x94D049BB133111EBULL;
    return z ^ z >> 31;
  }
  std::uint64_t below(std::uint64_t n) { return word() % n; }

 private:
  std::uint64_t state_;
};

/// Types Thing (every kind, and transient ones), SmallThing: Thing, abstract Idea; edges `part_of`-like
/// `in_box` (one target), `likes` (ordered, many).
[[nodiscard]] std::unique_ptr<Database> make_database();
/// A value of the kind: from plain to the hardest to keep.
[[nodiscard]] Value draw_value(Draws& draws, ValueKind kind);
/// One transaction: creates, sets, connects, removes.
void change(Database& db, std::uint64_t step);

/// A folder that goes with the object.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

}  // namespace rigor::world::test
