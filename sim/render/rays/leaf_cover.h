// What of a map is leaf and what is hole: at a point, and on the mean over an area, which is what a ray that
// is wider than a texel sees (a mip map of coverage; Williams, Pyramidal Parametrics, SIGGRAPH 1983).
// Internal to sim/render/rays.
#pragma once

#include <cstdint>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::render {

class LeafCover {
 public:
  /// `map` has texels. Alpha below the cutoff (0 to 1) is hole.
  LeafCover(const Texture& map, float alpha_cutoff);

  /// Coverage at a place below the cutoff. Bilinear; repeated or clamped as the map says.
  [[nodiscard]] bool hole_at(float u, float v) const noexcept;
  /// How much of a square about a place is leaf, of 255. `side_texels`: of the square, in the map's texels. A
  /// square of a texel or less is leaf or hole.
  [[nodiscard]] std::uint8_t leaf_at(float u, float v, float side_texels) const noexcept;

  [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
  [[nodiscard]] std::uint32_t height() const noexcept { return height_; }

 private:
  /// All that lies between four texels.
  enum Between : std::uint8_t { some = 0, hole = 1, leaf = 2 };
  struct Level {
    std::uint32_t width, height;
    std::vector<std::uint8_t> leaf;
  };
  /// What lies between texel (x, y) and those to the right and down.
  [[nodiscard]] Between between(std::uint32_t x, std::uint32_t y) const noexcept;
  void note_what_lies_between();
  void make_levels();

  std::uint32_t width_, height_;
  bool repeat_;
  float cutoff_;                        ///< of 255
  std::vector<std::uint8_t> coverage_;  ///< of the map
  /// From each texel on, to the right and down: two bits each, in tiles of 16 x 16, a cache line each.
  std::vector<std::uint8_t> between_;
  std::uint32_t tiles_across_;
  std::vector<Level> levels_;  ///< of half the side each, from half of the map's on
};

}  // namespace rigor::render
