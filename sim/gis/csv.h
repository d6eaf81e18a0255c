// Tables in CSV (RFC 4180; comma, semicolon or tab, found from the header line; UTF-8, with or without a byte
// order mark).
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::gis {

struct CsvRow {
  std::size_t line = 0;  ///< of the file, from 1
  std::vector<std::string> cells;
};

struct CsvTable {
  std::string file;
  std::vector<std::string> columns;
  std::vector<CsvRow> rows;
  [[nodiscard]] std::optional<std::size_t> find(std::string_view column) const;
  [[nodiscard]] std::string place(const CsvRow& row) const { return file + ":" + std::to_string(row.line); }
  /// The cells of a row by their columns' names; null for another name.
  [[nodiscard]] auto cells_of(const CsvRow& row) const {
    return [this, &row](const std::string& column) -> const std::string* {
      const auto c = find(column);
      return c ? &row.cells[*c] : nullptr;
    };
  }
};

/// Every row has a cell for every column. Errors: not_found; bad_input: no header, a column twice, a row that
/// is too short (a file cut short) or too long, an open quote; each with its line.
[[nodiscard]] Result<CsvTable> read_csv(const std::filesystem::path& file);

/// A number as it stands in data: "3.5", "-2e3"; nothing else around it but blanks. NaN for an empty cell,
/// "NA", "NaN", "null", "-". Empty where it is no number.
[[nodiscard]] std::optional<double> number_of(std::string_view text);

/// Splits `column=value` of ImportSource::where. bad_input.
struct Where {
  std::string column, value;
};
[[nodiscard]] Result<std::optional<Where>> parse_where(const std::string& text);

}  // namespace rigor::gis
