#include "sim/gis/draft.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/config/did_you_mean.h"
#include "sim/gis/csv.h"

namespace rigor::gis {
namespace {

struct LengthUnit {
  std::string_view suffix;
  double metres;
};
constexpr LengthUnit kLengths[] = {{"_mm", 1e-3}, {"_cm", 1e-2},   {"_dm", 0.1},   {"_m", 1},
                                   {"_km", 1e3},  {"_in", 0.0254}, {"_ft", 0.3048}};

double factor_between(std::string_view column, std::string_view attribute) {
  if (!attribute.ends_with("_m")) return 1;
  for (const auto& u : kLengths)
    if (column.ends_with(u.suffix)) return u.metres;
  return 1;
}

std::string joined(const std::vector<std::string>& words) {
  std::string all;
  for (const auto& w : words) all += (all.empty() ? "" : ", ") + w;
  return all.empty() ? "none" : all;
}

}  // namespace

Result<ColumnValue> ColumnValue::make(const std::string& text, const std::vector<std::string>& available,
                                      const std::string& what, const std::string& where) {
  ColumnValue v;
  v.text_ = text;
  const auto there = [&](const std::string& c) {
    return std::find(available.begin(), available.end(), c) != available.end();
  };
  if (there(text) || (available.empty() && text.find_first_of("*/+()[") == std::string::npos)) {
    v.columns_ = {text};
    return v;
  }
  auto parsed = Expression::parse(text);
  if (!parsed) return fail(ErrorCode::bad_input, where, fmt::format("{}: {}", what, parsed.error().message));
  v.columns_ = parsed->columns();
  for (const std::string& column : v.columns_)
    if (!available.empty() && !there(column))
      return fail(ErrorCode::bad_input, where,
                  fmt::format("{}: expected one of the columns {}, got '{}'{}", what, joined(available),
                              column, did_you_mean(column, available)));
  if (v.columns_.empty())
    return fail(ErrorCode::bad_input, where,
                fmt::format("{}: expected a column in '{}', got none", what, text));
  v.expression_ = std::move(*parsed);
  return v;
}

Result<double> ColumnValue::number(const CellOf& cell_of, const std::string& place) const {
  std::vector<double> cells;
  for (const std::string& column : columns_) {
    const std::string* const cell = cell_of(column);
    const auto number = cell ? number_of(*cell) : std::numeric_limits<double>::quiet_NaN();
    if (!number)
      return fail(ErrorCode::bad_input, place,
                  fmt::format("expected a number in column {}, got '{}'", column, *cell));
    cells.push_back(*number);
  }
  return expression_ ? expression_->value([&](std::size_t i) { return cells[i]; }) : cells.front();
}

void Complaints::add(const std::string& what, const std::string& place) {
  Entry& e = entries_[what];
  if (e.count++ == 0) e.first = place;
}

void Complaints::move_into(std::vector<std::string>& warnings, const std::string& where) {
  for (const auto& [what, e] : entries_)
    warnings.push_back(e.count == 1
                           ? fmt::format("{}: {}", e.first.empty() ? where : e.first, what)
                           : fmt::format("{}: {} times: {} (first: {})", where, e.count, what, e.first));
  entries_.clear();
}

Result<ColumnMapping> ColumnMapping::make(const world::Schema& schema, std::string_view type,
                                          const std::vector<std::pair<std::string, std::string>>& columns,
                                          const std::vector<std::string>& available,
                                          const std::vector<std::string>& extra, const std::string& where) {
  ColumnMapping mapping;
  const world::TypeId id = schema.require_type(type);
  std::vector<std::string> attributes = extra;
  for (const auto a : schema.attributes(id)) {
    const auto kind = schema.attribute(a).kind();
    if (kind == world::ValueKind::number || kind == world::ValueKind::text || kind == world::ValueKind::flag)
      attributes.push_back(schema.attribute(a).spec.name);
  }
  for (const auto& [attribute, column] : columns) {
    Entry e{.attribute = attribute, .source = {}};
    if (std::find(attributes.begin(), attributes.end(), attribute) == attributes.end()) {
      return fail(ErrorCode::bad_input, where,
                  fmt::format("columns: {}: expected an attribute of {} ({}), got '{}'{}", attribute, type,
                              joined(attributes), attribute, did_you_mean(attribute, attributes)));
    }
    if (const auto a = schema.find_attribute(id, attribute)) e.spec = &schema.attribute(*a).spec;
    auto source = ColumnValue::make(column, available, "columns: " + attribute, where);
    if (!source) return tl::unexpected(source.error());
    e.source = std::move(*source);
    const auto kind = e.spec ? world::kind_of(e.spec->default_value) : world::ValueKind::number;
    if (!e.source.plain() && kind != world::ValueKind::number)
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("columns: {}: expected the name of a column, as it is no number, got the expression "
                      "'{}'",
                      attribute, column));
    if (e.source.plain()) e.factor = factor_between(column, attribute);
    mapping.entries_.push_back(std::move(e));
  }
  return mapping;
}

Result<std::optional<world::Value>> ColumnMapping::value(Entry& entry, const CellOf& cell_of,
                                                         const std::string& place,
                                                         Complaints& complaints) const {
  using Maybe = std::optional<world::Value>;
  static const std::string kNone;
  const std::string& column = entry.source.text();
  const std::string* const found = entry.source.plain() ? cell_of(column) : &kNone;
  if (!found) return Maybe();
  const std::string& cell = *found;
  const world::AttributeSpec* spec = entry.spec;
  const auto kind = spec ? world::kind_of(spec->default_value) : world::ValueKind::number;
  if (kind == world::ValueKind::text) {
    if (cell.empty() || cell == "NA") return Maybe();
    if (!spec->choices.empty() &&
        std::find(spec->choices.begin(), spec->choices.end(), cell) == spec->choices.end()) {
      complaints.add(fmt::format("{} '{}' is none of {}; left at '{}'", entry.attribute, cell,
                                 joined(spec->choices), std::get<std::string>(spec->default_value)),
                     place);
      return Maybe();
    }
    return Maybe(cell);
  }
  if (kind == world::ValueKind::flag) {
    if (cell.empty() || cell == "NA") return Maybe();
    for (const char* word : {"1", "true", "TRUE", "True", "yes", "y", "Y", "t", "T"})
      if (cell == word) return Maybe(true);
    for (const char* word : {"0", "false", "FALSE", "False", "no", "n", "N", "f", "F"})
      if (cell == word) return Maybe(false);
    return fail(
        ErrorCode::bad_input, place,
        fmt::format("{}: expected true or false in column {}, got '{}'", entry.attribute, column, cell));
  }
  auto number = entry.source.number(cell_of, place + ": " + entry.attribute);
  if (!number) return tl::unexpected(number.error());
  if (std::isnan(*number)) return Maybe();
  const double v = *number * entry.factor;
  ++entry.given;
  if (spec && !(v >= spec->min && v <= spec->max)) {
    ++entry.refused;
    complaints.add(
        fmt::format("{} lies outside of {} … {}; left unknown", entry.attribute, spec->min, spec->max),
        place);
    return Maybe();
  }
  return Maybe(v);
}

Status ColumnMapping::finish(const std::string& where) const {
  for (const Entry& e : entries_)
    if (e.refused * 2 > e.given && e.refused > 1)
      return fail(
          ErrorCode::bad_input, where,
          fmt::format(
              "columns: {}: expected values from {} to {}, got {} of {} outside: is the unit of column {} "
              "right? ({}: {}*0.01 converts)",
              e.attribute, e.spec->min, e.spec->max, e.refused, e.given, e.source.text(), e.attribute,
              e.source.text()));
  return {};
}

}  // namespace rigor::gis
