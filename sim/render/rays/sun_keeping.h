// Shares of the sun's light that are kept from ray to ray and from picture to picture. A triangle is cut into
// square cells, about as wide as a few pixels of whoever looks at it. What the sun sends to a cell is a
// function of the cell, of what stands still and of the sun, never of what was asked before, so that an
// answer is the same whether it was kept or not. Internal to sim/render/rays.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <optional>

#include "sim/render/rays/embree_scene.h"
#include "sim/render/rays/light_vec.h"

namespace rigor::render::light {

/// A cell of a triangle.
struct SunCell {
  std::uint64_t group = 0;  ///< of 4 x 2 cells, which are kept beside each other; 0: no cell
  int column = 0, row = 0;  ///< along the triangle's first edge, and across it
  float side_m = 0;         ///< a power of two
  [[nodiscard]] bool any() const noexcept { return group != 0; }
  [[nodiscard]] bool same_as(const SunCell& o) const noexcept {
    return group == o.group && column == o.column && row == o.row;
  }
};

/// The cell in which the point lies that was met, of about this width. No cell: a triangle without area, a
/// width of 0, far too many cells.
[[nodiscard]] SunCell sun_cell(const RayScene::Triangle& t, const Intersection& m, float width_m) noexcept;
/// Its middle, or what of the triangle is near it.
[[nodiscard]] Vec3 middle_of(const RayScene::Triangle& t, const SunCell& cell) noexcept;

class KeptSun {
 public:
  /// What shares depend on, but for the cell.
  struct Key {
    std::uint64_t still_version = 0;
    Eigen::Vector3d scene_origin = Eigen::Vector3d::Zero();
    Vec3 to_sun;
    float sun_radius_rad = 0;
  };
  /// Shares that are found and kept from now on. Not while other threads do. The first call takes the memory.
  void about(const Key& key);
  /// Has the share on its way from memory. Any thread, as what follows.
  void fetch(const SunCell& cell) const noexcept;
  [[nodiscard]] std::optional<float> find(const SunCell& cell) const noexcept;
  /// The share as find() will have it, rounded.
  float keep(const SunCell& cell, float share) noexcept;

 private:
  static constexpr std::size_t kCells = std::size_t{1} << 22U;  ///< 32 MiB
  struct Slot {
    std::size_t at;
    std::uint64_t tag;  ///< its lowest 16 bits are 0
  };
  [[nodiscard]] Slot slot_of(const SunCell& cell) const noexcept;

  std::uint64_t salt_ = 0;
  /// Each slot: 16 bits of a share, above 0, and 48 of whose it is. 0: empty.
  struct Free {
    void operator()(std::uint64_t* slots) const noexcept { std::free(slots); }
  };
  std::unique_ptr<std::uint64_t[], Free> slots_;
};

}  // namespace rigor::render::light
