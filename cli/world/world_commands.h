// `rigor world import`, `info` and `export`: from GIS data to a world's file, and what is in one. Each
// returns the exit status: 0 good, 1 ran and failed, 2 bad input and nothing touched.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace rigor {

struct WorldImportOptions {
  std::filesystem::path plan;          ///< *.import.yaml; empty: the sources below
  std::vector<std::string> overrides;  ///< --set, of the plan
  /// Each a path or a server's address; vectors also PATH=WORD or PATH:LAYER=WORD (WORD: what it becomes).
  std::vector<std::string> elevation, imagery, land_cover, vectors, trees, weather;
  std::vector<std::string> plugin_files;  ///< FILE or FILE=IMPORTER, read by importers of plugins
  std::string anchor;                     ///< LAT,LON[,H]
  std::optional<double> half_extent_m, spacing_m;
  std::string crs;      ///< of sources that do not say it themselves
  std::string classes;  ///< of land cover: worldcover | corine | words
  bool heights_above_geoid = false;
  std::filesystem::path cache_dir;
  std::filesystem::path output;
  bool force = false;  ///< write over a file that is there
  bool json = false;
};
struct WorldInfoOptions {
  std::filesystem::path world;
  bool json = false;
};
struct WorldExportOptions {
  std::filesystem::path world, output;  ///< output: *.yaml, or *.csv for a map of stems
  /// Above the foot, where stems are measured for the map; empty: their feet and diameters of the inventory.
  std::optional<double> at_height_m;
  bool force = false;
  bool json = false;
};

int world_import_command(const WorldImportOptions& options);
int world_info_command(const WorldInfoOptions& options);
int world_export_command(const WorldExportOptions& options);

}  // namespace rigor
