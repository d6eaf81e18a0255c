// From GIS data to a semantic world, in one transaction: an import that fails leaves the world as it was.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sim/world/graph/database.h"

namespace rigor::gis {

/// Where the world frame (east, north, up) stands on the WGS84 ellipsoid. `height_m` NaN: on the ground that
/// is imported there; 0 where none is.
struct Anchor {
  double latitude_deg = 0, longitude_deg = 0, height_m = 0;
};

/// Where the local frame of a tree list stands: its origin and the azimuth (from north over east) of its y
/// axis; x points to the right of y.
struct Plot {
  double latitude_deg = 0, longitude_deg = 0, y_axis_azimuth_deg = 0;
};

/// What is imported, each from a file or a server's address, as an import file (YAML) or the command line
/// give it.
struct ImportSource {
  enum class Kind : std::uint8_t {
    elevation,
    imagery,
    land_cover,
    vector,
    trees,
    weather
  } kind = Kind::elevation;
  std::string location;  ///< a path, or `WCS:http://…`, `WMS:…`, `WFS:…`
  /// E.g. EPSG:25832 where the data does not say; never guessed. `local`: x east and y north in the world
  /// frame (tree lists and vectors).
  std::string crs = "";
  std::string layer = "";  ///< of a vector file or server; empty: the only one
  /// Of vectors: building | road | fence | pole | water | tree | a land cover word | osm (each feature by its
  /// tags). Empty: osm for an OpenStreetMap file, else an error.
  std::string becomes = "";
  /// Attribute = column of the data, or an expression over columns (expression.h). A column whose name ends
  /// in another unit of length than the attribute's (`_mm`, `_cm`, `_km`, `_in`, `_ft`) is converted. Of tree
  /// lists also x, y, lon, lat, id and plot.
  std::vector<std::pair<std::string, std::string>> columns = {};
  /// Land cover: value = cover word, or `unknown`.
  std::vector<std::pair<std::string, std::string>> classes = {};
  bool heights_above_geoid = false;  ///< elevation above EGM96 instead of the ellipsoid
  std::string where = "";            ///< `column=value`: only these rows or features
  std::optional<Plot> plot = {};     ///< of tree lists with plot-local x, y
  /// CSV of plots with columns latitude_deg, longitude_deg, y_axis_azimuth_deg and one that the tree list has
  /// too: each tree is placed in the plot that it names.
  std::string plots = "";
  /// Of the plots' file: plot, latitude_deg, longitude_deg, y_axis_azimuth_deg = column or expression.
  std::vector<std::pair<std::string, std::string>> plot_columns = {};
};

/// Grids (Terrain, LandCover, Imagery) become one of each kind: of several sources the first in the list wins
/// where it has data.
struct ImportPlan {
  std::optional<Anchor> anchor;  ///< empty: the middle of the first source that has a place
  /// Extent around the anchor; what lies outside is left out. Empty: all.
  std::optional<double> half_extent_m;
  double spacing_m = 0;                  ///< of grids in the world; 0: as fine as the finest source
  std::filesystem::path cache_dir = "";  ///< of what servers answered; empty: $XDG_CACHE_HOME/rigor/gis
  double server_timeout_s = 30;          ///< of each request
  /// Date and time of the Atmosphere; empty: the first row of a weather series, else 10 o'clock by the sun on
  /// the longest day of 2024.
  std::optional<double> utc_s = {};
  std::vector<ImportSource> sources;
  /// Told now and then what is being read and how much of the whole is done (0 … 1). Same thread.
  std::function<void(std::string_view what, double done)> progress = {};
};

struct ImportReport {
  Anchor anchor;
  std::size_t nodes = 0;
  std::vector<std::string> lines;     ///< what came of each source
  std::vector<std::string> warnings;  ///< what was left out or mended, and why, with its place
};

/// Errors: not_found, bad_input (a file cut short, a layer without a reference system, an unknown column:
/// file, layer, feature, what was expected), unavailable (a server). Nothing is written then.
[[nodiscard]] Result<ImportReport> import_into(world::Database& db, const ImportPlan& plan);
/// A plan from YAML. Paths in it are relative to its folder. Errors: not_found, bad_input.
[[nodiscard]] Result<ImportPlan> load_import_plan(const std::filesystem::path& file,
                                                  const std::vector<ConfigOverride>& overrides = {});
/// A mapping that is built in: `worldcover` (ESA WorldCover), `corine` (CORINE Land Cover, both the 111…523
/// and the 1…44 numbering) or `words` (band values 0, 1, 2 … in the order of kCoverWords). bad_input: another
/// name.
[[nodiscard]] Result<std::vector<std::pair<std::string, std::string>>> class_set(std::string_view name);
/// "46.8,8.2" or "46.8,8.2,1200". bad_input.
[[nodiscard]] Result<Anchor> parse_anchor(std::string_view text);
/// "2024-06-21T10:00:00Z", "2024-06-21 12:00+02:00": seconds since 1970. bad_input: anything else; without Z
/// or an offset too.
[[nodiscard]] Result<double> parse_utc(std::string_view text, const std::string& where);

}  // namespace rigor::gis
