// Diffuse light that surroundings send to the points of a query, gathered at a part of the points and shared
// with those near them (irradiance caching after Ward et al. 1988, with cells of a grid in place of records).
// What hides the sky, what walls and leaves scatter, and light through leaves are in it, as far as the paths
// lead. Internal to sim/render/rays.
//
// What a grid holds is a function of the paths and sky rays that were added: light_keeping.h says which a
// picture has.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "sim/render/rays/light_shading.h"

namespace rigor::render::light {

/// What one path brought to a place from the half space about a normal, its direction drawn by the cosine.
struct GatheredPath {
  Vec3 place;   ///< relative to the scene's cell
  Vec3 normal;  ///< unit length
  float range_m = 0;
  Bands4 scattered{};              ///< what came back from what its first segment met
  Bands4 open{};                   ///< what is in its first direction where nothing stands
  bool free = false;               ///< its first segment met nothing
  std::uint8_t ray = 0, draw = 0;  ///< which ray of the chunk met the place, and which of its paths this is
  /// Of the paths of its point (of a leaf: of that side), and of their first segments and sky rays together:
  /// each point counts alike.
  float part_of_paths = 1, part_of_rays = 1;
  // Its first segment, for those who ask whether something has come in between.
  Vec3 start, direction;
  float first_m = std::numeric_limits<float>::infinity();
};

/// What more rays, directions drawn by the cosine, found of the open sky (and of what lies below the horizon)
/// about a place. Most of the noise of gathered light is whether a direction is free, and such a ray costs a
/// tenth of a path.
struct GatheredSky {
  static constexpr unsigned kMostRays = 8;
  Vec3 place, normal;
  float range_m = 0;
  Vec3 start;
  std::array<Vec3, kMostRays> direction;
  unsigned rays = 0;
  float part_of_rays = 1;  ///< of each, as of a path
  unsigned free = 0;       ///< a bit for each ray: nothing stands there
  Bands4 open{};           ///< sum over all rays of what is there where nothing stands
  Bands4 sky{};            ///< … over free ones
};

struct Gathered {
  std::vector<GatheredPath> paths;
  std::vector<GatheredSky> skies;
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
  /// The light about one place, for any number of directions: what they share is found once. Belongs to one
  /// thread.
  class About;
  /// `cell_rad`: side of a cell as seen from the query's origin, above 0.
  explicit GatheredLight(float cell_rad) : cell_rad_(cell_rad) {}
  /// Serial; the order counts in rounding alone.
  void add(const Gathered& gathered);

 private:
  /// A path counts in so many levels, from that of its range on: in thin regions a coarser one answers.
  static constexpr int kLevels = 4;
  /// Of the places whose normal looks along one of the axes, weighted by the square of their normal's part.
  struct Sum {
    Bands4 scattered, open, sky;
    /// [0] of paths, [1] of rays that met nothing, [3] of all rays, first segments of paths included; those
    /// of a point add up to 1 each. [2]: paths, each as one; interpolation leaves it as it is, so that it
    /// says how much the cells hold.
    Bands4 weight;
  };
  struct Cell {
    std::uint64_t key = 0;  ///< 0: empty
    Sum axis[6]{};
  };
  /// Means over what looks along some directions.
  struct Mean {
    Bands4 scattered{}, open{}, sky{};
    float free = 0;   ///< share of rays that met nothing
    float known = 0;  ///< share of the directions along which there are paths
  };
  /// Squares of a unit normal's parts, and which of the six axes they look along.
  struct Parts {
    float weight[3];
    int axis[3];
  };
  [[nodiscard]] static Parts parts_of(Vec3 normal) noexcept;
  [[nodiscard]] static Mean mean_of(const Sum& x, const Sum& y, const Sum& z, const Parts& parts) noexcept;
  [[nodiscard]] int level_of(float range_m) const noexcept;
  /// In all levels of a place.
  void add(Vec3 place, Vec3 normal, float range_m, const Sum& of);
  Cell& cell(std::uint64_t key);
  [[nodiscard]] const Cell* find(std::uint64_t key) const noexcept;

  float cell_rad_;
  std::vector<Cell> cells_;  ///< open addressing, a power of two
  std::size_t used_ = 0;
  Sum everywhere_[6]{};
};

class GatheredLight::About {
 public:
  About(const GatheredLight& light, Vec3 place, float range_m, Found& found) noexcept
      : light_(light), found_(found), place_(place), finest_(light.level_of(range_m)) {}
  /// W/m² on a plane of this normal, where open sky and ground alone would send `open`
  /// (LightFrame::irradiance). Where nothing was gathered near: the mean of all that was gathered, or `open`
  /// where nothing was.
  [[nodiscard]] Bands4 irradiance(Vec3 normal, Bands4 open) noexcept;

 private:
  /// The eight cells of a level about the place, less those without paths.
  struct Level {
    unsigned cells, summed;  ///< `summed`: a bit for each axis
    const Cell* cell[8];
    float share[8];
    Sum axis[6];  ///< sums over the cells; the weight's third part without their shares
  };
  void enter(int k) noexcept;  ///< level finest_ + k
  [[nodiscard]] static const Sum& sum(Level& level, int axis) noexcept;

  const GatheredLight& light_;
  Found& found_;
  const Vec3 place_;
  const int finest_;
  unsigned entered_ = 0;  ///< a bit for each level
  Level levels_[kLevels];
};

}  // namespace rigor::render::light
