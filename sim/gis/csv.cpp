#include "sim/gis/csv.h"

#include <cpl_string.h>
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <sstream>

namespace rigor::gis {
namespace {

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t' || s.back() == '\r')) s.remove_suffix(1);
  return s;
}

char separator_of(std::string_view header) {
  char best = ',';
  std::ptrdiff_t most = 0;
  for (const char c : {',', ';', '\t'})
    if (const auto n = std::count(header.begin(), header.end(), c); n > most) best = c, most = n;
  return best;
}

// One record from `at` on; false where a quote never ends.
bool read_record(std::string_view text, char separator, std::size_t& at, std::size_t& line, CsvRow& row) {
  row.line = line;
  row.cells.assign(1, "");
  bool quoted = false, was_quoted = false;
  const auto end_cell = [&] {
    if (!was_quoted) row.cells.back() = std::string(trimmed(row.cells.back()));
    was_quoted = false;
  };
  for (; at < text.size(); ++at) {
    const char c = text[at];
    if (c == '\n') ++line;
    if (quoted) {
      if (c != '"')
        row.cells.back() += c;
      else if (at + 1 < text.size() && text[at + 1] == '"')
        row.cells.back() += text[++at];
      else
        quoted = false;
    } else if (c == '"' && trimmed(row.cells.back()).empty() && !was_quoted) {
      quoted = was_quoted = true;
      row.cells.back().clear();
    } else if (c == separator) {
      end_cell();
      row.cells.emplace_back();
    } else if (c == '\n') {
      ++at;
      end_cell();
      return true;
    } else if (!(was_quoted && (c == '\r' || c == ' '))) {
      row.cells.back() += c;
    }
  }
  end_cell();
  return !quoted;
}

}  // namespace

std::optional<std::size_t> CsvTable::find(std::string_view column) const {
  const auto it = std::find(columns.begin(), columns.end(), column);
  if (it == columns.end()) return std::nullopt;
  return static_cast<std::size_t>(it - columns.begin());
}

Result<CsvTable> read_csv(const std::filesystem::path& file) {
  CsvTable table;
  table.file = file.string();
  std::error_code ec;
  std::ifstream in(file, std::ios::binary);
  if (!in || std::filesystem::is_directory(file, ec))
    return fail(ErrorCode::not_found, table.file, "expected a CSV file, there is none that can be read");
  std::ostringstream all;
  all << in.rdbuf();
  const std::string bytes = std::move(all).str();
  std::string_view text = bytes;
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  if (text.find('\0') != std::string_view::npos || !CPLIsUTF8(bytes.c_str(), -1))
    return fail(ErrorCode::bad_input, table.file,
                "expected CSV text in UTF-8, got bytes that are none; save it as UTF-8");
  const char separator = separator_of(text.substr(0, text.find('\n')));
  std::size_t at = 0, line = 1;
  CsvRow row;
  while (at < text.size()) {
    if (!read_record(text, separator, at, line, row))
      return fail(ErrorCode::bad_input, table.place(row),
                  "expected a closing quote, got the end of the file: it is cut short");
    if (row.cells.size() == 1 && row.cells[0].empty()) continue;  // an empty line
    if (table.columns.empty()) {
      table.columns = std::move(row.cells);
      auto sorted = table.columns;
      std::sort(sorted.begin(), sorted.end());
      if (const auto twice = std::adjacent_find(sorted.begin(), sorted.end()); twice != sorted.end())
        return fail(ErrorCode::bad_input, table.place(row),
                    fmt::format("expected each column once, got '{}' twice", *twice));
      continue;
    }
    if (row.cells.size() != table.columns.size())
      return fail(ErrorCode::bad_input, table.place(row),
                  fmt::format("expected {} cells as in the header, got {}{}", table.columns.size(),
                              row.cells.size(), at >= text.size() ? ": the file is cut short" : ""));
    table.rows.push_back(std::move(row));
    row = {};
  }
  if (table.columns.empty())
    return fail(ErrorCode::bad_input, table.file,
                "expected a header line with the columns' names, got an empty file");
  return table;
}

std::optional<double> number_of(std::string_view text) {
  text = trimmed(text);
  if (text.empty() || text == "NA" || text == "NaN" || text == "nan" || text == "null" || text == "NULL" ||
      text == "-")
    return std::numeric_limits<double>::quiet_NaN();
  if (text.front() == '+') text.remove_prefix(1);
  double v = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), v);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(v)) return std::nullopt;
  return v;
}

Result<std::optional<Where>> parse_where(const std::string& text) {
  if (text.empty()) return std::optional<Where>();
  const auto equals = text.find('=');
  if (equals == std::string::npos || equals == 0)
    return fail(ErrorCode::bad_input, "where", fmt::format("expected column=value, got '{}'", text));
  return std::optional<Where>(Where{text.substr(0, equals), text.substr(equals + 1)});
}

}  // namespace rigor::gis
