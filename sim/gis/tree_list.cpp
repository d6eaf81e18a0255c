#include "sim/gis/tree_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <unordered_map>

#include "rt-core/numbers.h"
#include "sim/gis/csv.h"
#include "sim/gis/gdal_support.h"
#include "sim/world/semantic_types.h"

namespace rigor::gis {
namespace {

using world::Value;

std::optional<std::size_t> first_of(const CsvTable& t, std::initializer_list<std::string_view> names) {
  for (const auto name : names)
    if (const auto c = t.find(name)) return c;
  return std::nullopt;
}

std::string names_of(const CsvTable& t) {
  std::string all;
  for (const auto& c : t.columns) all += (all.empty() ? "" : ", ") + c;
  return all;
}

Result<double> cell_number(const CsvTable& t, const CsvRow& row, const ColumnValue& column) {
  const auto v = column.number(t.cells_of(row), t.place(row));
  if (!v || !std::isnan(*v)) return v;
  const std::string* const cell = column.plain() ? t.cells_of(row)(column.text()) : nullptr;
  return fail(ErrorCode::bad_input, t.place(row),
              fmt::format("{}: expected a number, got '{}'", column.text(), cell ? *cell : "nothing"));
}

using Columns = std::vector<std::pair<std::string, std::string>>;

/// What of a row is no attribute of a tree: where it stands, and which one it is.
constexpr std::string_view kPlacingKeys[] = {"x", "y", "lon", "lat", "plot", "id"};
bool is_placing(std::string_view key) {
  return std::ranges::find(kPlacingKeys, key) != std::end(kPlacingKeys);
}

/// The column that `columns` maps to the key, else the first of the usual names; empty where there is none.
Result<std::optional<ColumnValue>> value_of(const CsvTable& t, const Columns& columns, std::string_view key,
                                            std::initializer_list<std::string_view> usual) {
  using Maybe = std::optional<ColumnValue>;
  std::string text;
  for (const auto& [k, column] : columns)
    if (k == key) text = column;
  if (text.empty()) {
    const auto found = first_of(t, usual);
    if (!found) return Maybe();
    text = t.columns[*found];
  }
  auto value = ColumnValue::make(text, t.columns, fmt::format("columns: {}", key), t.file);
  if (!value) return tl::unexpected(value.error());
  return Maybe(std::move(*value));
}
/// As value_of, of what is no number: one column.
Result<std::optional<std::size_t>> column_of(const CsvTable& t, const Columns& columns, std::string_view key,
                                             std::initializer_list<std::string_view> usual) {
  using Maybe = std::optional<std::size_t>;
  auto value = value_of(t, columns, key, usual);
  if (!value) return tl::unexpected(value.error());
  if (!*value) return Maybe();
  if (!(*value)->plain())
    return fail(ErrorCode::bad_input, t.file,
                fmt::format("columns: {}: expected the name of a column, got the expression '{}'", key,
                            (*value)->text()));
  return Maybe(*t.find((*value)->text()));
}

// What the source does not map itself: columns named as attributes, in any unit of length.
std::vector<std::pair<std::string, std::string>> with_found_columns(
    const world::Schema& schema, const CsvTable& table,
    std::vector<std::pair<std::string, std::string>> columns) {
  for (const auto a : schema.attributes(schema.require_type("Tree"))) {
    const std::string& attribute = schema.attribute(a).spec.name;
    const auto mapped = [&](const auto& c) { return c.first == attribute; };
    if (attribute == "name" || std::any_of(columns.begin(), columns.end(), mapped)) continue;
    if (table.find(attribute)) {
      columns.emplace_back(attribute, attribute);
    } else if (attribute.ends_with("_m")) {
      for (const char* unit : {"_cm", "_mm", "_ft", "_in"})
        if (const std::string c = attribute.substr(0, attribute.size() - 2) + unit; table.find(c)) {
          columns.emplace_back(attribute, c);
          break;
        }
    }
  }
  return columns;
}

struct Placing {
  ColumnValue x, y;
  bool geographic = false, local = false;
  TransformationPtr to_geo;
  std::optional<Plot> plot;
  std::map<std::string, Plot> plots;
  std::size_t plot_column = 0;
  std::optional<std::size_t> id;
};

Result<std::map<std::string, Plot>> read_plots(const ImportSource& source, const CsvTable& trees,
                                               std::size_t& join) {
  auto table = read_csv(source.plots);
  if (!table) return tl::unexpected(table.error());
  const Columns& columns = source.plot_columns;
  const auto lat = value_of(*table, columns, "latitude_deg", {"latitude_deg", "latitude", "lat"});
  const auto lon = value_of(*table, columns, "longitude_deg", {"longitude_deg", "longitude", "lon"});
  const auto azimuth =
      value_of(*table, columns, "y_axis_azimuth_deg", {"y_axis_azimuth_deg", "azimuth_deg", "azimuth"});
  for (const auto* v : {&lat, &lon, &azimuth})
    if (!*v) return tl::unexpected(v->error());
  if (!*lat || !*lon || !*azimuth)
    return fail(
        ErrorCode::bad_input, table->file,
        fmt::format(
            "expected columns latitude_deg, longitude_deg, y_axis_azimuth_deg, got {}; map others with "
            "plots: {{ file: …, columns: {{ latitude_deg: … }} }}",
            names_of(*table)));
  // By the mappings of both files; else a column that both have.
  auto of_trees = column_of(trees, source.columns, "plot", {});
  if (!of_trees) return tl::unexpected(of_trees.error());
  auto own = column_of(*table, columns, "plot", {});
  if (!own) return tl::unexpected(own.error());
  std::optional<std::size_t> key = *own;
  if (!key && *of_trees) key = table->find(trees.columns[**of_trees]);
  const auto placed = [&](const std::string& name) {
    return name == (*lat)->text() || name == (*lon)->text() || name == (*azimuth)->text();
  };
  for (std::size_t c = 0; c < table->columns.size() && !key && !*of_trees; ++c)
    if (trees.find(table->columns[c]) && !placed(table->columns[c])) key = c;
  if (key && !*of_trees) *of_trees = trees.find(table->columns[*key]);
  if (key && *of_trees) join = **of_trees;
  if (!key || !*of_trees)
    return fail(
        ErrorCode::bad_input, table->file,
        fmt::format(
            "expected a column that names the plot as one of the trees' columns ({}) does, got {}; name them "
            "with columns: {{ plot: … }} of the trees and of the plots",
            names_of(trees), names_of(*table)));
  std::map<std::string, Plot> plots;
  for (const CsvRow& row : table->rows) {
    const auto a = cell_number(*table, row, **lat), b = cell_number(*table, row, **lon),
               c = cell_number(*table, row, **azimuth);
    for (const auto* v : {&a, &b, &c})
      if (!*v) return tl::unexpected(v->error());
    if (std::abs(*a) > 90 || std::abs(*b) > 360)
      return fail(ErrorCode::bad_input, table->place(row),
                  fmt::format("expected latitude and longitude in degrees, got {}, {}", *a, *b));
    if (!plots.emplace(row.cells[*key], Plot{*a, *b, *c}).second)
      return fail(ErrorCode::bad_input, table->place(row),
                  fmt::format("expected each plot once, got {} twice", row.cells[*key]));
  }
  return plots;
}

Result<Placing> find_placing(const ImportSource& source, const CsvTable& t) {
  Placing p;
  const Columns& columns = source.columns;
  const auto id = column_of(t, columns, "id", {"tree_id", "treeid", "id", "tree_no"});
  if (!id) return tl::unexpected(id.error());
  p.id = *id;
  const auto lon_or = value_of(t, columns, "lon", {"lon", "lng", "longitude", "longitude_deg"}),
             lat_or = value_of(t, columns, "lat", {"lat", "latitude", "latitude_deg"}),
             x_or = value_of(t, columns, "x", {"x_m", "x", "X", "easting", "easting_m"}),
             y_or = value_of(t, columns, "y", {"y_m", "y", "Y", "northing", "northing_m"});
  for (const auto* v : {&lon_or, &lat_or, &x_or, &y_or})
    if (!*v) return tl::unexpected(v->error());
  const auto &lon = *lon_or, &lat = *lat_or, &x = *x_or, &y = *y_or;
  // x and y that are mapped are meant, whatever else the table has.
  const bool mapped_xy =
      std::ranges::any_of(columns, [](const auto& c) { return c.first == "x" || c.first == "y"; });
  p.plot = source.plot;
  if (source.plot && !source.plots.empty())
    return fail(ErrorCode::bad_input, t.file, "expected plot or plots, got both");
  if (source.plot || !source.plots.empty()) {
    if (!x || !y)
      return fail(
          ErrorCode::bad_input, t.file,
          fmt::format(
              "expected columns x_m, y_m in the plot, got {}; map others with columns: {{ x: …, y: … }}",
              names_of(t)));
    if (!source.crs.empty()) return fail(ErrorCode::bad_input, t.file, "expected a plot or a crs, got both");
    p.x = *x, p.y = *y;
    if (!source.plots.empty()) {
      auto plots = read_plots(source, t, p.plot_column);
      if (!plots) return tl::unexpected(plots.error());
      p.plots = std::move(*plots);
    }
    return p;
  }
  if (lon && lat && !mapped_xy) {
    p.geographic = true;
    p.x = *lon, p.y = *lat;
  } else if (x && y) {
    p.x = *x, p.y = *y;
    p.local = source.crs == "local";
    if (source.crs.empty())
      return fail(ErrorCode::bad_input, t.file,
                  "expected to be told what x and y mean: crs (such as EPSG:25832, or local), plot or plots");
  } else {
    return fail(
        ErrorCode::bad_input, t.file,
        fmt::format("expected columns lon, lat or x, y, got {}; map others with columns: {{ x: …, y: … }}",
                    names_of(t)));
  }
  if (!source.crs.empty() && !p.local) {
    auto crs = parse_crs(source.crs, t.file + ": crs");
    if (!crs) return tl::unexpected(crs.error());
    auto to_geo = transformation(*crs, wgs84(), t.file);
    if (!to_geo) return tl::unexpected(to_geo.error());
    p.to_geo = std::move(*to_geo);
  }
  return p;
}

Result<GeoPoint> place_of(const Placing& p, const CsvTable& t, const CsvRow& row) {
  const auto x = cell_number(t, row, p.x), y = cell_number(t, row, p.y);
  if (!x) return tl::unexpected(x.error());
  if (!y) return tl::unexpected(y.error());
  if (p.local) return GeoPoint{*y, *x, kNaN};
  GeoPoint place{*y, *x, kNaN};
  if (p.plot || !p.plots.empty()) {
    Plot plot = p.plot.value_or(Plot{});
    if (!p.plot) {
      const auto it = p.plots.find(row.cells[p.plot_column]);
      if (it == p.plots.end())
        return fail(ErrorCode::bad_input, t.place(row),
                    fmt::format("{}: expected a plot of the plots' file, got '{}'", t.columns[p.plot_column],
                                row.cells[p.plot_column]));
      plot = it->second;
    }
    place = from_plot(plot, *x, *y);
    place.height_m = kNaN;
  } else if (p.to_geo) {
    const GdalMessages messages;
    double e = *x, n = *y;
    if (!p.to_geo->Transform(1, &e, &n)) n = kNaN;
    place = {n, e, kNaN};
  }
  if (!std::isfinite(place.longitude_deg) || !(std::abs(place.latitude_deg) <= 90) ||
      std::abs(place.longitude_deg) > 540)
    return fail(ErrorCode::bad_input, t.place(row),
                fmt::format("expected a place on the earth, got {} {}, {} {}: is the reference system right?",
                            p.x.text(), *x, p.y.text(), *y));
  return place;
}

}  // namespace

Result<TreeList> read_trees(const world::Schema& schema, const ImportSource& source) {
  auto table = read_csv(source.location);
  if (!table) return tl::unexpected(table.error());
  auto placing = find_placing(source, *table);
  if (!placing) return tl::unexpected(placing.error());
  auto where = parse_where(source.where);
  if (!where) return tl::unexpected(where.error());
  std::optional<std::size_t> where_column;
  if (*where) {
    where_column = table->find((*where)->column);
    if (!where_column)
      return fail(
          ErrorCode::bad_input, table->file,
          fmt::format("where: expected one of the columns {}, got '{}'", names_of(*table), (*where)->column));
  }
  Columns attributes;
  for (const auto& c : source.columns)
    if (!is_placing(c.first)) attributes.push_back(c);
  const auto columns = with_found_columns(schema, *table, std::move(attributes));
  if (std::none_of(columns.begin(), columns.end(), [](const auto& c) { return c.first == "dbh_m"; }))
    for (const char* name : {"dbh", "DBH", "diameter"})
      if (table->find(name))
        return fail(
            ErrorCode::bad_input, table->file,
            fmt::format("expected to be told the unit of column {0}: columns: {{dbh_m: {0}*0.01}} for "
                        "centimetres, {{dbh_m: {0}}} for metres",
                        name));
  auto mapping = ColumnMapping::make(schema, "Tree", columns, table->columns, {"foot_height_m"}, table->file);
  if (!mapping) return tl::unexpected(mapping.error());

  TreeList list;
  list.where = table->file;
  list.local = placing->local;
  const auto id = placing->id;
  std::unordered_map<std::string, std::size_t> seen;
  Complaints complaints;
  std::size_t without_dbh = 0, without_species = 0;
  for (const CsvRow& row : table->rows) {
    if (where_column && row.cells[*where_column] != (*where)->value) continue;
    if (id && !row.cells[*id].empty() && row.cells[*id] != "NA") {
      std::string key = row.cells[*id];
      if (!placing->plots.empty()) key += '\n' + row.cells[placing->plot_column];
      if (const auto [it, fresh] = seen.emplace(std::move(key), row.line); !fresh) {
        complaints.add(fmt::format("{} stands there twice; the first is kept", table->columns[*id]),
                       table->place(row));
        continue;
      }
    }
    auto place = place_of(*placing, *table, row);
    if (!place) return tl::unexpected(place.error());
    TreeList::Entry tree{.place = *place, .attributes = {{"dbh_m", Value(0.0)}}};
    bool dbh = false, species = false;
    for (auto& entry : mapping->entries()) {
      auto v = mapping->value(entry, table->cells_of(row), table->place(row), complaints);
      if (!v) return tl::unexpected(v.error());
      if (!*v) continue;
      if (entry.attribute == "foot_height_m") {
        tree.place.height_m = std::get<double>(**v);
        continue;
      }
      dbh |= entry.attribute == "dbh_m" && std::get<double>(**v) > 0;
      species |= entry.attribute == "species";
      tree.attributes.emplace_back(entry.attribute, std::move(**v));
    }
    without_dbh += !dbh;
    without_species += !species;
    list.trees.push_back(std::move(tree));
  }
  if (auto s = mapping->finish(table->file); !s) return tl::unexpected(s.error());
  complaints.move_into(list.warnings, table->file);
  if (list.trees.empty())
    list.warnings.push_back(table->file +
                            (source.where.empty() ? ": no trees" : ": no trees where " + source.where));
  if (without_dbh > 0)
    list.warnings.push_back(fmt::format(
        "{}: {} trees without a diameter; their size comes from their species", table->file, without_dbh));
  if (without_species > 0)
    list.warnings.push_back(fmt::format("{}: {} trees without a species", table->file, without_species));
  return list;
}

Status add_trees(const TreeList& list, const Ground& ground, std::optional<double> half_extent_m,
                 bool has_terrain, Draft& draft, std::vector<std::string>& report) {
  std::vector<GeoPoint> places;
  for (const auto& t : list.trees) places.push_back(t.place);
  std::vector<double> heights(places.size());
  if (!list.local)
    if (auto s = ground.heights_at(places, heights); !s) return s;
  std::size_t outside = 0, made = 0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    GeoPoint p = places[i];
    const bool exact = !std::isnan(p.height_m);
    world::Vector3 v;
    if (list.local) {
      v = {p.longitude_deg, p.latitude_deg, p.height_m};
    } else {
      if (!exact) p.height_m = heights[i];
      v = ground.frame().to_world(p);
      if (v.z() < -3e6) {
        ++outside;
        continue;
      }
    }
    if (!exact) v.z() = has_terrain ? kNaN : ground.z_at(v.x(), v.y());
    if (half_extent_m && (std::abs(v.x()) > *half_extent_m || std::abs(v.y()) > *half_extent_m)) {
      ++outside;
      continue;
    }
    DraftNode node{"Tree", list.trees[i].attributes};
    node.attributes.emplace_back("position", v);
    draft.nodes.push_back(std::move(node));
    ++made;
  }
  report.push_back(fmt::format("{}: {} tree{}", list.where, made,
                               outside > 0 ? fmt::format("; {} outside of the extent", outside) : ""));
  return {};
}

}  // namespace rigor::gis
