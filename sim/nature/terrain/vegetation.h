// Where the plants of one GroundVegetation node stand. Each is a function of (seed, cell, number), so the
// same plants stand there whatever was asked before, and thinning leaves out the later numbers of every cell.
#pragma once

#include <memory>
#include <vector>

#include "sim/nature/terrain/ground.h"
#include "sim/nature/terrain/plants.h"
#include "sim/render/content/provider.h"

namespace rigor::nature {

/// A road's line as far as plants keep off it.
struct Track {
  world::Numbers line;
  double half_width_m = 0;
  Rect bounds;
};

/// What the plants stand on; immutable.
struct PlantGround {
  Ground ground;  ///< covers and waters; heights come from `heights`
  std::shared_ptr<const render::GroundHeights> heights;
  std::vector<Track> tracks;
};

struct PlantLayer {
  NodeId node;
  std::uint8_t cover = kNoCover;
  Plant plant = Plant::grass;
  double per_m2 = 0, height_m = 0, height_spread = 0;
  std::uint64_t seed = 0;
  double cell_m = 4;     ///< of the finest cells: a few hundred plants each, a power of two
  double spacing_m = 1;  ///< mean way to the next plant
  std::array<std::shared_ptr<const render::Prototype>, 2> prototypes;
};
/// Cells of a layer are thinned to a quarter, a sixteenth, … of their plants, each twice, four times, … as
/// wide.
inline constexpr int kMostThinned = 3;

/// A square of 2^size finest cells, thinned 4^thinned times.
struct PlantCell {
  std::size_t layer = 0;
  int size = 0, thinned = 0;
  std::int64_t i = 0, j = 0;
  bool operator==(const PlantCell&) const = default;
};
[[nodiscard]] Rect rect_of(const PlantLayer& layer, const PlantCell& cell);

/// The layers of a world, by node id. What cannot be shown is told of.
[[nodiscard]] std::vector<PlantLayer> read_layers(const world::Snapshot& world,
                                                  std::vector<std::string>& warnings);
[[nodiscard]] std::vector<Track> read_tracks(const world::Snapshot& world);

/// Share of a rectangle's land cover cells that are of the cover, those around counted in; 0: no plant stands
/// there.
[[nodiscard]] double cover_share(const PlantGround& ground, const Rect& rect, std::uint8_t cover);

/// The plants of a cell; one batch for each of the two individuals, null where it has none.
[[nodiscard]] std::array<std::shared_ptr<render::Batch>, 2> plant_cell(const PlantGround& ground,
                                                                       const PlantLayer& layer,
                                                                       const PlantCell& cell);

}  // namespace rigor::nature
