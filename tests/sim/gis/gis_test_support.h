// Inputs for tests of the importers: rasters and vector files made on the spot, and worlds to import into.
#pragma once

#include <gdal_priv.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "sim/gis/import.h"
#include "sim/world/semantic_types.h"

namespace rigor::gis::test {

inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// A folder of its own that goes with the object.
class Folder {
 public:
  Folder();
  ~Folder();
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  [[nodiscard]] std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  /// Writes a text file and returns its path.
  std::string write(const std::string& name, const std::string& text) const;

 private:
  std::filesystem::path path_;
};

struct RasterSpec {
  int width = 4, height = 4, bands = 1;
  std::array<double, 6> geotransform = {0, 1, 0, 0, 0, -1};
  std::string crs = "EPSG:4326";  ///< empty: none
  GDALDataType type = GDT_Float32;
  double nodata = kNaN;
  bool has_nodata = false;
  double scale = 1, offset = 0;
  std::string unit = "";
  std::function<double(int column, int row, int band)> value = [](int, int, int) { return 0.0; };
};
/// A GeoTIFF.
void write_raster(const std::string& file, const RasterSpec& spec);

[[nodiscard]] std::unique_ptr<world::Database> fresh_world();
[[nodiscard]] ImportSource source(ImportSource::Kind kind, std::string location);

/// Imports one source around an anchor; the world is left in `db`.
struct Imported {
  std::unique_ptr<world::Database> db;
  Result<ImportReport> report = fail(ErrorCode::internal, "", "");
  [[nodiscard]] world::Snapshot world() const { return db->snapshot(); }
  [[nodiscard]] std::vector<world::NodeId> nodes(std::string_view type) const {
    return world().nodes(world().schema().require_type(type));
  }
  [[nodiscard]] std::string complaint() const { return report ? "" : report.error().text(); }
  [[nodiscard]] std::string warnings() const;
};
[[nodiscard]] Imported import(const ImportPlan& plan);

struct TerrainView {
  std::int64_t columns = 0, rows = 0;
  double x_m = 0, y_m = 0, spacing_m = 0;
  std::vector<float> z;
  [[nodiscard]] double at(std::int64_t column, std::int64_t row) const {
    return z[static_cast<std::size_t>(row * columns + column)];
  }
  /// Of the cell nearest to (x, y).
  [[nodiscard]] double near(double x, double y) const {
    return at(std::lround((x - x_m) / spacing_m), std::lround((y_m - y) / spacing_m));
  }
};
[[nodiscard]] TerrainView terrain_of(const world::Snapshot& world);

/// The test data NAME where they are present, else empty.
[[nodiscard]] std::string shared_data(const std::string& name);

}  // namespace rigor::gis::test
