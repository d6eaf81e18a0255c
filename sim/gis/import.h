// From GIS data to a semantic world, in one transaction: an import that fails leaves the world as it was.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/world/graph/database.h"

namespace rigor::gis {

/// Where the world frame (east, north, up) stands on the WGS84 ellipsoid.
struct Anchor {
  double latitude_deg = 0, longitude_deg = 0, height_m = 0;
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
  std::string location;      ///< a path, or `WCS:http://…`, `WMS:…`, `WFS:…`
  std::string crs = "";      ///< e.g. EPSG:25832 where the data does not say; never guessed
  std::string layer = "";    ///< of a vector file or server; empty: the only one
  std::string becomes = "";  ///< of vectors: building | road | fence | pole | water | tree | land cover word
  std::vector<std::pair<std::string, std::string>> columns = {};  ///< attribute = column of the data
  std::vector<std::pair<std::string, std::string>> classes = {};  ///< land cover: value = cover word
  bool heights_above_geoid = false;  ///< elevation above EGM96 instead of the ellipsoid
};

struct ImportPlan {
  std::optional<Anchor> anchor;  ///< empty: the middle of the first source that has a place
  /// Extent around the anchor; what lies outside is left out. Empty: all.
  std::optional<double> half_extent_m;
  double spacing_m = 0;                  ///< of grids in the world; 0: as fine as the source
  std::filesystem::path cache_dir = "";  ///< of what servers answered; empty: the user's cache folder
  std::vector<ImportSource> sources;
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
/// A plan from YAML. Errors: not_found, bad_input.
[[nodiscard]] Result<ImportPlan> load_import_plan(const std::filesystem::path& file);

}  // namespace rigor::gis
