#include "sim/gis/draft.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

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
    Entry e{.attribute = attribute, .column = column};
    if (std::find(attributes.begin(), attributes.end(), attribute) == attributes.end()) {
      const std::string near = nearest(attribute, attributes);
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("columns: {}: expected an attribute of {} ({}), got '{}'{}", attribute, type,
                      joined(attributes), attribute, near.empty() ? "" : "; did you mean " + near + "?"));
    }
    if (const auto a = schema.find_attribute(id, attribute)) e.spec = &schema.attribute(*a).spec;
    const auto there = [&](const std::string& c) {
      return available.empty() || std::find(available.begin(), available.end(), c) != available.end();
    };
    const auto star = column.rfind('*');
    if (star != std::string::npos && (available.empty() || !there(column))) {
      const auto factor = number_of(std::string_view(column).substr(star + 1));
      if (!factor || std::isnan(*factor))
        return fail(
            ErrorCode::bad_input, where,
            fmt::format("columns: {}: expected column or column*factor, got '{}'", attribute, column));
      e.factor = *factor;
      e.column = column.substr(0, star);
      while (e.column.ends_with(' ')) e.column.pop_back();
    } else {
      e.factor = factor_between(column, attribute);
    }
    if (!there(e.column)) {
      const std::string near = nearest(e.column, available);
      return fail(
          ErrorCode::bad_input, where,
          fmt::format("columns: {}: expected one of the columns {}, got '{}'{}", attribute, joined(available),
                      e.column, near.empty() ? "" : "; did you mean " + near + "?"));
    }
    mapping.entries_.push_back(std::move(e));
  }
  return mapping;
}

Result<std::optional<world::Value>> ColumnMapping::value(Entry& entry, const std::string& cell,
                                                         const std::string& place,
                                                         Complaints& complaints) const {
  using Maybe = std::optional<world::Value>;
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
    return fail(ErrorCode::bad_input, place,
                fmt::format("{}: expected true or false in column {}, got '{}'", entry.attribute,
                            entry.column, cell));
  }
  const auto number = number_of(cell);
  if (!number)
    return fail(
        ErrorCode::bad_input, place,
        fmt::format("{}: expected a number in column {}, got '{}'", entry.attribute, entry.column, cell));
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
              e.attribute, e.spec->min, e.spec->max, e.refused, e.given, e.column, e.attribute, e.column));
  return {};
}

}  // namespace rigor::gis
