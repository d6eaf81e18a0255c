// Diffuse light that surroundings send to the points of a query, gathered at a part of the points and shared
// with those near them (irradiance caching after Ward et al. 1988, with cells of a grid in place of records).
// What hides the sky, what walls and leaves scatter, and light through leaves are in it, as far as the paths
// lead. Internal to sim/render/rays.
//
// What a grid holds is a function of the paths that were added: light_keeping.h says which a picture has.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "sim/render/rays/light_shading.h"

namespace rigor::render::light {

/// What one path brought to a place from the half space about a normal.
struct GatheredPath {
  Vec3 place;   ///< relative to the scene's cell
  Vec3 normal;  ///< unit length
  float range_m = 0;
  Bands4 radiance{};  ///< what the path found, directions drawn by the cosine to the normal
  Bands4 open{};      ///< what is in its first direction where nothing stands
  bool free = false;  ///< its first segment met nothing
  // Its first segment, for those who ask whether something has come in between.
  Vec3 start, direction;
  float first_m = std::numeric_limits<float>::infinity();
};

class GatheredLight {
  struct Cell;

 public:
  /// Cells that were found before, of one thread: neighbouring points ask for the same ones.
  class Found {
    friend class GatheredLight;
    struct Eight {
      std::uint64_t key = 0;  ///< of the lowest one; 0: none
      std::array<const Cell*, 8> cells{};
    };
    std::array<Eight, 16> eights_;
  };
  /// `cell_rad`: side of a cell as seen from the query's origin, above 0.
  explicit GatheredLight(float cell_rad) : cell_rad_(cell_rad) {}
  /// Serial; the order of the paths counts in rounding alone.
  void add(std::span<const GatheredPath> paths);
  /// W/m² on a plane of this normal. Where nothing was gathered near: the mean of all that was gathered, or
  /// of the open sky where nothing was. Any thread.
  [[nodiscard]] Bands4 irradiance(const LightFrame& frame, Vec3 place, Vec3 normal, float range_m,
                                  Found& found) const noexcept;

 private:
  /// Of the paths whose normal looks along one of the axes, weighted by the square of their normal's part.
  struct Sum {
    Bands4 radiance{}, open{};
    float weight = 0, free = 0;
  };
  struct Cell {
    std::uint64_t key = 0;  ///< 0: empty
    Sum axis[6];
  };
  [[nodiscard]] int level_of(float range_m) const noexcept;
  Cell& cell(std::uint64_t key);
  [[nodiscard]] const Cell* find(std::uint64_t key) const noexcept;
  /// Of the eight cells of a level about a place; weight 0 where they hold too little.
  [[nodiscard]] Sum near(int level, Vec3 place, Vec3 normal, Found& found) const noexcept;
  /// Of the axes that a normal looks along, those along which something was gathered.
  [[nodiscard]] static Sum along(const Sum (&axis)[3], const float (&weight)[3]) noexcept;

  float cell_rad_;
  std::vector<Cell> cells_;  ///< open addressing, a power of two
  std::size_t used_ = 0;
  Sum everywhere_[6];
};

}  // namespace rigor::render::light
