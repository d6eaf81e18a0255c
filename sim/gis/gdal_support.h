// GDAL without its surprises: drivers registered once, messages collected instead of printed, every reference
// system in x-east y-north order.
#pragma once

#include <gdal_priv.h>
#include <ogr_spatialref.h>

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::gis {

/// Any thread, any number of times.
void register_gdal();

/// Collects what GDAL complains of on this thread while it lives.
class GdalMessages {
 public:
  GdalMessages();
  ~GdalMessages();
  GdalMessages(const GdalMessages&) = delete;
  GdalMessages& operator=(const GdalMessages&) = delete;
  [[nodiscard]] bool failed() const noexcept { return !failures_.empty(); }
  /// The first failure, else the first warning, else "no reason given"; one line.
  [[nodiscard]] std::string text() const;
  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept { return warnings_; }
  void clear();

 private:
  static void CPL_STDCALL on_message(CPLErr level, CPLErrorNum number, const char* text);
  std::vector<std::string> failures_, warnings_;
};

struct DatasetCloser {
  void operator()(GDALDataset* d) const { GDALClose(d); }
};
using DatasetPtr = std::unique_ptr<GDALDataset, DatasetCloser>;

/// Opens a file to be read. `flags`: GDAL_OF_RASTER or GDAL_OF_VECTOR. Errors: not_found; bad_input with
/// GDAL's reason.
[[nodiscard]] Result<DatasetPtr> open_dataset(const std::string& file, unsigned flags);

/// "EPSG:25832", WKT, a PROJ string; in traditional axis order. bad_input.
[[nodiscard]] Result<OGRSpatialReference> parse_crs(std::string_view text, const std::string& where);
[[nodiscard]] OGRSpatialReference wgs84();

struct TransformationDeleter {
  void operator()(OGRCoordinateTransformation* t) const { OGRCoordinateTransformation::DestroyCT(t); }
};
using TransformationPtr = std::unique_ptr<OGRCoordinateTransformation, TransformationDeleter>;

/// Horizontal only: what is vertical in either is left out. bad_input: there is no way between the two.
[[nodiscard]] Result<TransformationPtr> transformation(OGRSpatialReference from, OGRSpatialReference to,
                                                       const std::string& where);
/// (longitude, latitude, height above EGM96) to (longitude, latitude, height above the ellipsoid).
/// unavailable: PROJ has no grid of the geoid.
[[nodiscard]] Result<TransformationPtr> geoid_transformation();

}  // namespace rigor::gis
