// What an import has read, in full, before the first write to the world.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/gis/grid.h"
#include "sim/world/graph/schema.h"

namespace rigor::gis {

struct DraftNode {
  std::string type;
  std::vector<std::pair<std::string, world::Value>> attributes;  ///< later ones win
};

/// An area of one cover, in the world frame: rings closed or not, inside by even-odd.
struct CoverArea {
  std::vector<std::vector<double>> rings;  ///< x0 y0 x1 y1 …
  double area_m2 = 0;
  std::uint8_t word = 0;  ///< index into kCoverWords
  int source = 0;
};

struct Draft {
  std::vector<DraftNode> nodes;
  std::vector<CoverArea> areas;
};

/// Counts what was left out or mended, so that a thousand cases make one warning.
class Complaints {
 public:
  void add(const std::string& what, const std::string& place);
  void move_into(std::vector<std::string>& warnings, const std::string& where);

 private:
  struct Entry {
    std::size_t count = 0;
    std::string first;
  };
  std::map<std::string, Entry> entries_;
};

/// How columns of data become attributes of one type.
class ColumnMapping {
 public:
  /// `type`: of the semantic types; `available`: names of the data's columns. bad_input: an attribute that
  /// the type lacks, a column that the data lacks; the nearest name is offered. `extra`: attributes beside
  /// the type's own (numbers).
  [[nodiscard]] static Result<ColumnMapping> make(
      const world::Schema& schema, std::string_view type,
      const std::vector<std::pair<std::string, std::string>>& columns,
      const std::vector<std::string>& available, const std::vector<std::string>& extra,
      const std::string& where);
  struct Entry {
    std::string attribute, column;
    double factor = 1;
    const world::AttributeSpec* spec = nullptr;  ///< null: of `extra`
    std::size_t given = 0, refused = 0;
  };
  [[nodiscard]] std::vector<Entry>& entries() noexcept { return entries_; }
  /// The value of a cell; empty where it is unknown or outside of the attribute's limits (a complaint).
  /// bad_input: no number.
  [[nodiscard]] Result<std::optional<world::Value>> value(Entry& entry, const std::string& cell,
                                                          const std::string& place,
                                                          Complaints& complaints) const;
  /// bad_input: most values of an attribute lie outside its limits, so its unit is wrong.
  [[nodiscard]] Status finish(const std::string& where) const;

 private:
  std::vector<Entry> entries_;
};

}  // namespace rigor::gis
