// Sunlight through leaves, kept from ray to ray and from picture to picture. Each triangle is divided into
// square cells about three pixels wide, as seen by the eye that asks. How much sunlight reaches a cell
// depends on the cell, on what stands still and on the sun alone, so that an answer is the same whether it
// was kept or is worked out anew. Internal to sim/render/rays.
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

/// The cell about the point that was met, of about this width. No cell: of a triangle without area, a width
/// of 0, and where an edge would have more than a million of them.
[[nodiscard]] SunCell sun_cell(const RayScene::Triangle& t, const Intersection& m, float width_m) noexcept;
/// The triangle's place that is nearest to the cell's middle.
[[nodiscard]] Vec3 middle_of(const RayScene::Triangle& t, const SunCell& cell) noexcept;

/// The sunlight of a cell.
struct SunShare {
  float clear = 0;  ///< what gets through, of 1
  /// Whether leaves decide it (RayScene::clear_share_alone). If not, each point asks for itself: edges of
  /// shadows of what has no holes stay sharp there.
  bool leaves = false;
};

class KeptSun {
 public:
  /// Whose answers are found and kept from now on. Not while other threads find or keep. The first call takes
  /// 32 MiB of address space, whose pages fill up as cells are kept. False: there is no memory.
  [[nodiscard]] bool about(std::uint64_t still_serial, Vec3 to_sun, float sun_radius_rad) noexcept;
  /// Prefetches the answer. Any thread, as what follows.
  void fetch(const SunCell& cell) const noexcept;
  /// Another cell's answer, by its hash, comes with a probability of 2^-45.
  [[nodiscard]] std::optional<SunShare> find(const SunCell& cell) const noexcept;
  /// The answer as find() will have it, rounded.
  SunShare keep(const SunCell& cell, SunShare share) noexcept;

 private:
  static constexpr std::size_t kSlots = std::size_t{1} << 22U;
  struct Slot {
    std::size_t at;
    std::uint64_t tag;  ///< its lowest 16 bits are 0
  };
  [[nodiscard]] Slot slot_of(const SunCell& cell) const noexcept;
  struct Free {
    void operator()(void* memory) const noexcept { std::free(memory); }
  };

  std::uint64_t salt_ = 0;
  std::unique_ptr<void, Free> memory_;
  /// Each slot: 16 bits of an answer, above 0, and 48 of whose it is. 0: empty. Groups begin cache lines.
  std::uint64_t* slots_ = nullptr;
};

}  // namespace rigor::render::light
