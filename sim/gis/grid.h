// Grids of the world frame from rasters in any reference system: each cell is mapped back to the ellipsoid
// and to the raster exactly, at the height of the ground there.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "sim/gis/raster.h"

namespace rigor::gis {

/// Cells of a grid in the world frame; as sim/world/semantic_types.h has it.
struct Grid {
  std::int64_t columns = 0, rows = 0;
  double x_m = 0, y_m = 0;  ///< centre of the north-western cell
  double spacing_m = 1;
  [[nodiscard]] std::size_t cells() const {
    return static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows);
  }
};

using Progress = std::function<void(double done)>;  ///< 0 … 1, on the thread that asked
using Rasters = std::vector<std::unique_ptr<Raster>>;

/// A grid around the anchor, or around what the rasters cover, as fine as the finest raster where
/// `spacing_m` is 0; and the rasters made as coarse as it is. bad_input: more than 64 million cells, or
/// farther than 1000 km from the anchor.
[[nodiscard]] Result<Grid> plan_grid(const LocalFrame& frame, const Rasters& rasters,
                                     std::optional<double> half_extent_m, double spacing_m);

class Mosaic;

/// Heights of the ground, as z in the world frame and as heights above the ellipsoid.
class Ground {
 public:
  /// Flat at the anchor's height.
  explicit Ground(const LocalFrame& frame) : frame_(frame) {}
  /// From rasters, of which the first with data wins. They outlive the ground.
  void use(const Rasters* rasters);
  /// From a Terrain that the world has already.
  void use(Grid grid, std::vector<float> z_m);

  /// z of the ground at cell centres; NaN: a hole. Errors: those of Raster::status.
  [[nodiscard]] Result<std::vector<float>> z_grid(const Grid& grid, const Progress& progress) const;
  /// z of the ground at (x, y) of the grid that z_grid made or `use` gave, else of the surface at the
  /// anchor's height.
  [[nodiscard]] double z_at(double x_m, double y_m) const;
  /// Height above the ellipsoid at places; where there is no data, the anchor's. Errors: those of
  /// Raster::status.
  [[nodiscard]] Status heights_at(std::span<const GeoPoint> places, std::span<double> heights_m) const;
  void keep(Grid grid, std::vector<float> z_m) { grid_ = grid, z_m_ = std::move(z_m); }
  [[nodiscard]] const LocalFrame& frame() const noexcept { return frame_; }

 private:
  const LocalFrame& frame_;
  const Rasters* rasters_ = nullptr;
  mutable std::shared_ptr<Mosaic> mosaic_;  // of heights_at, kept between calls
  Grid grid_;
  std::vector<float> z_m_;
};

/// r g b of each cell; 0 0 0: no data (a black pixel becomes 1 1 1).
[[nodiscard]] Result<std::vector<std::byte>> picture_grid(const Grid& grid, const Ground& ground,
                                                          const Rasters& rasters, const Progress& progress);
/// Of each cell: which raster has data there (first wins; -1: none) and its value.
struct CoverCell {
  std::int32_t raster = -1;
  float value = 0;
};
[[nodiscard]] Result<std::vector<CoverCell>> cover_grid(const Grid& grid, const Ground& ground,
                                                        const Rasters& rasters, const Progress& progress);

}  // namespace rigor::gis
