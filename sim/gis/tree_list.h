// Tree inventories in CSV. Columns that have the name of a Tree attribute (species, dbh_m, height_m …, also
// in other units: dbh_cm) are found by themselves, as are the places:
//
//   lon, lat (longitude_deg, latitude_deg …)      on WGS84, or in the given crs
//   x, y (x_m, y_m, easting, northing)            in the given crs; of a plot; or, crs `local`, of the world
//   frame
#pragma once

#include "sim/gis/draft.h"

namespace rigor::gis {

struct TreeList {
  std::string where;
  struct Entry {
    GeoPoint
        place;  ///< height: of the foot, NaN: on the ground; `local`: longitude is x, latitude y, height z
    std::vector<std::pair<std::string, world::Value>> attributes;
  };
  bool local = false;
  std::vector<Entry> trees;
  std::vector<std::string> warnings;
};

/// Errors: not_found; bad_input: with file and line.
[[nodiscard]] Result<TreeList> read_trees(const world::Schema& schema, const ImportSource& source);

/// Adds Tree nodes.
[[nodiscard]] Status add_trees(const TreeList& list, const Ground& ground,
                               std::optional<double> half_extent_m, bool has_terrain, Draft& draft,
                               std::vector<std::string>& report);

/// Weather over time: a column `utc_s` (Unix time) or `time` (ISO 8601 with Z or an offset), and columns with
/// the names of Atmosphere attributes. A value that is missing is taken from the row before.
struct Weather {
  std::vector<std::string> columns;
  std::vector<double> table;  ///< row by row: utc_s, value, value …
  std::vector<std::string> warnings;
  [[nodiscard]] std::size_t rows() const { return table.size() / (columns.size() + 1); }
};
[[nodiscard]] Result<Weather> read_weather(const world::Schema& schema, const ImportSource& source);

}  // namespace rigor::gis
