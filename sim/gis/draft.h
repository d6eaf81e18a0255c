// What an import has read, in full, before the first write to the world.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/gis/expression.h"
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

/// The cell of a column in the row at hand; null where the row has none.
using CellOf = std::function<const std::string*(const std::string& column)>;

/// A number from a row: a column, or an expression over columns.
class ColumnValue {
 public:
  /// `text`: the name of a column as it stands, or an expression; `available`: the columns that there are,
  /// empty where that is not known. bad_input: `what` is where the message begins.
  [[nodiscard]] static Result<ColumnValue> make(const std::string& text,
                                                const std::vector<std::string>& available,
                                                const std::string& what, const std::string& where);
  /// Whether it is one column and nothing else: its text counts.
  [[nodiscard]] bool plain() const noexcept { return !expression_; }
  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  [[nodiscard]] const std::vector<std::string>& columns() const noexcept { return columns_; }
  /// NaN: unknown. bad_input: a cell that is no number.
  [[nodiscard]] Result<double> number(const CellOf& cell, const std::string& place) const;

 private:
  std::string text_;
  std::vector<std::string> columns_;
  std::optional<Expression> expression_;
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
    std::string attribute;
    ColumnValue source;
    double factor = 1;                           ///< of a plain column in another unit than the attribute
    const world::AttributeSpec* spec = nullptr;  ///< null: of `extra`
    std::size_t given = 0, refused = 0;
  };
  [[nodiscard]] std::vector<Entry>& entries() noexcept { return entries_; }
  /// The value in a row; empty where it is unknown or outside of the attribute's limits (a complaint).
  /// bad_input: no number.
  [[nodiscard]] Result<std::optional<world::Value>> value(Entry& entry, const CellOf& cell_of,
                                                          const std::string& place,
                                                          Complaints& complaints) const;
  /// bad_input: most values of an attribute lie outside its limits, so its unit is wrong.
  [[nodiscard]] Status finish(const std::string& where) const;

 private:
  std::vector<Entry> entries_;
};

}  // namespace rigor::gis
