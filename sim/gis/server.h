// Data from WCS, WMS and WFS servers, by way of files on disk: what a server has answered in full is kept
// under the name of the request, and the next import does not ask again. A request that fails leaves nothing.
#pragma once

#include "sim/gis/vector.h"

namespace rigor::gis {

/// `WCS:http://…`, `WMS:http://…`, `WFS:http://…`.
[[nodiscard]] bool is_server(std::string_view location);

struct ServerOptions {
  std::filesystem::path cache_dir;  ///< empty: $XDG_CACHE_HOME/rigor/gis, else ~/.cache/rigor/gis
  double timeout_s = 30;
  double spacing_m = 0;  ///< of pictures; 0: 1 m
};
struct Fetched {
  std::string file;
  bool from_cache = false;
};

/// The file with the server's answer for the domain (all, without one; WMS needs one). Errors: unavailable
/// (no answer, half an answer, a server's own complaint), bad_input (an address or a layer that is not
/// there), not_writable (the cache).
///
///   WCS  layer: the coverage; whole pixels of the coverage's own grid → GeoTIFF
///   WMS  layer, crs (EPSG:4326 where none is given): pixels of `spacing_m` on multiples of it → GeoTIFF
///   WFS  layer: the feature type → GeoPackage
[[nodiscard]] Result<Fetched> fetch(const ImportSource& source, const std::optional<Domain>& domain,
                                    const ServerOptions& options);

}  // namespace rigor::gis
