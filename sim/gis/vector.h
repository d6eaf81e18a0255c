// Vector data of any format that GDAL reads, as features on the ellipsoid.
#pragma once

#include <ogr_geometry.h>

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sim/gis/frame.h"
#include "sim/gis/gdal_support.h"

namespace rigor::gis {

struct Feature {
  /// Longitude, latitude (x, y) on WGS84; with the crs `local`: x, y of the world frame. Straight segments
  /// only.
  std::unique_ptr<OGRGeometry> geometry;
  std::vector<std::pair<std::string, std::string>> fields;  ///< those that are set; of OSM: all tags
  std::string place;                                        ///< file, layer, feature
  [[nodiscard]] const std::string* field(std::string_view name) const;
};

struct VectorData {
  std::string where;  ///< file and layer
  bool osm = false, local = false;
  std::vector<std::string> columns;  ///< empty: any (OSM)
  std::vector<Feature> features;
  std::vector<std::string> warnings;
};

/// Features of the layer that `source` names. `domain`: what lies clearly outside of this much around the
/// anchor may be left out. Errors: not_found; bad_input: a file cut short, a layer that is not there or not
/// named, a layer without a reference system.
struct Domain {
  const LocalFrame* frame = nullptr;
  double half_extent_m = 0;
};
[[nodiscard]] Result<VectorData> read_vector(const std::string& file, const ImportSource& source,
                                             const std::optional<Domain>& domain);
/// The same from an open dataset.
[[nodiscard]] Result<VectorData> read_vector(GDALDataset& dataset, const std::string& name,
                                             const ImportSource& source, const std::optional<Domain>& domain);

/// A rectangle of a reference system that holds the domain; empty where there is none (a pole, the
/// antimeridian).
[[nodiscard]] std::optional<OGREnvelope> rectangle_of(const Domain& domain, const OGRSpatialReference& crs);

/// Places of all vertices, for the middle of a source.
[[nodiscard]] std::vector<GeoPoint> places_of(const VectorData& data);

}  // namespace rigor::gis
