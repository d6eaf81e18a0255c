// The ground as all grids of a world give it together: height, slope, cover, water. Immutable once built, so
// any thread may read it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "sim/nature/terrain/noise.h"
#include "sim/nature/terrain/raster.h"

namespace rigor::nature {

/// Bilinear at (u, v) in cells; NaN outside and where a height that counts is NaN.
[[nodiscard]] double grid_height(const HeightGrid& grid, double u, double v);
/// dz/dx and dz/dy by central differences of the grid, bilinear between its points.
[[nodiscard]] Eigen::Vector2d grid_slope(const HeightGrid& grid, double u, double v);
/// True where the four heights around cell (c, r) to (c + 1, r + 1) are numbers.
[[nodiscard]] bool quad_valid(const HeightGrid& grid, int c, int r);

/// How much of a rectangle something takes.
enum class Share : std::uint8_t { none, all, part };

/// Covers at one place and how much of each; weights add up to 1. `kBareGround`: nobody says what is there.
inline constexpr std::uint8_t kBareGround = 16;
struct CoverMix {
  int count = 0;
  std::array<std::uint8_t, 4> cover{};
  std::array<float, 4> weight{};
  [[nodiscard]] std::uint8_t strongest() const;
};
/// Borders between covers wander by this noise, a stream for each cover.
[[nodiscard]] FractalNoise border_noise(std::uint8_t cover, double spacing_m);

/// A sheet of water: a Water node's outline, or cells of a land cover that hang together.
struct WaterBody {
  NodeId node;
  Rect bounds;
  double level_m = 0;  ///< of a flat one
  /// A river: too steep to be flat. The ground itself is its surface, and it has no sheet.
  bool follows = false;
  world::Numbers outline;  ///< of a Water node
  std::size_t grid = 0;    ///< else: cells of land cover grid…
  std::vector<int> cells;  ///< …row·columns + column, ascending
};

class Ground {
 public:
  Ground() = default;
  /// What cannot be used is told of in `warnings`.
  Ground(const world::Snapshot& world, std::vector<std::string>& warnings);
  /// As above, with the waters of `same_waters`, whose world differs in nothing that they lie on.
  Ground(const world::Snapshot& world, std::vector<std::string>& warnings, const Ground& same_waters);

  std::vector<HeightGrid> terrain;  ///< finest first
  std::vector<CoverGrid> covers;
  std::vector<PictureGrid> pictures;
  std::vector<WaterBody> waters;

  /// Of the finest grid that has a height here; from grid `first` on.
  [[nodiscard]] double height_at(double x, double y, std::size_t first = 0) const;
  [[nodiscard]] Eigen::Vector2d slope_at(double x, double y) const;
  /// How much of a rectangle the grids finer than `grid` cover with heights.
  [[nodiscard]] Share covered_by_finer(std::size_t grid, const Rect& rect) const;

  /// `border(cover, spacing)` gives the border noise there; it is asked only near borders.
  template <class Border>
  [[nodiscard]] CoverMix cover_mix(double x, double y, const Border& border) const {
    for (const auto& g : covers) {
      CoverMix mix;
      if (mix_in(g, x, y, mix)) {
        if (mix.count > 1) sharpen(mix, [&](std::uint8_t c) { return border(c, g.frame.spacing_m); });
        return mix;
      }
    }
    return {1, {kBareGround}, {1.0F}};
  }
  /// The cover of a whole rectangle, where cover_mix() has no other and no border in it.
  [[nodiscard]] std::optional<std::uint8_t> one_cover(const Rect& rect) const;
  /// The cover that counts at a point.
  [[nodiscard]] std::uint8_t cover_at(double x, double y) const;
  /// True where a point of the ground at height z lies under a flat sheet of water.
  [[nodiscard]] bool under_sheet(double x, double y, double z) const;
  /// True where the ground is the surface of a river, borders between covers counted.
  [[nodiscard]] bool is_river(double x, double y) const;
  /// True where a river's cells come near a rectangle.
  [[nodiscard]] bool river_near(const Rect& rect) const;
  /// True where a point of the ground at height z lies under water of any kind.
  [[nodiscard]] bool under_water(double x, double y, double z) const;

 private:
  /// The body whose cells hold a point, or null.
  [[nodiscard]] const WaterBody* body_at(double x, double y) const;
  static bool mix_in(const CoverGrid& grid, double x, double y, CoverMix& mix);
  template <class Noise>
  static void sharpen(CoverMix& mix, const Noise& noise) {
    float sum = 0;
    for (int i = 0; i < mix.count; ++i) {
      const auto n = static_cast<float>(noise(mix.cover[i]));
      float w = mix.weight[i] * std::clamp(1 + 0.7F * n, 0.05F, 2.5F);
      w *= w;
      mix.weight[i] = w * w;
      sum += mix.weight[i];
    }
    for (int i = 0; i < mix.count; ++i) mix.weight[i] /= sum;
  }
  void find_waters(const world::Snapshot& world);
  /// Cell number → body, for grids with water cells.
  std::shared_ptr<const std::vector<std::vector<std::int32_t>>> water_of_cell_;
  std::vector<std::string> water_warnings_;
  std::size_t outlined_from_ = 0;  ///< waters from here on are Water nodes
};

}  // namespace rigor::nature
