// From features on the ellipsoid to nodes of the world: every vertex by itself into the world frame, at the
// height of the ground there; footprints mended, lines and areas cut at the extent.
#pragma once

#include "sim/gis/draft.h"
#include "sim/gis/vector.h"

namespace rigor::gis {

struct ShapeOptions {
  std::optional<double> half_extent_m;
  bool has_terrain = false;  ///< what stands on the ground then takes its z from it
  int source = 0;            ///< rank of the source, for cover areas
};

/// Adds to `draft`. `report`: a line of what came of it. Errors: bad_input (an unknown column, a value that
/// is no number, what the features should become).
[[nodiscard]] Status add_features(const world::Schema& schema, VectorData data, const ImportSource& source,
                                  const Ground& ground, const ShapeOptions& options, Draft& draft,
                                  std::vector<std::string>& report, std::vector<std::string>& warnings);

/// Index into kCoverWords; empty where it is none.
[[nodiscard]] std::optional<std::uint8_t> cover_word(std::string_view word);

}  // namespace rigor::gis
