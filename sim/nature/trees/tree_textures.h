// Pictures of foliage and bark, drawn by rule, and the surfaces that wear them.
//
// A foliage atlas holds the cards that crowns are made of. v runs from the base of a twig (bottom of its
// cell) to its tip (top):
//
//   +--------+--------+-----------------+
//   | twig 0 | twig 1 |                 |   twigs 0, 1: lit; 2, 3: old, shaded, inner ones
//   +--------+--------+  bough          |   bough: a whole branch with its twigs, for coarse levels
//   | twig 2 | twig 3 |                 |
//   +--------+--------+-----------------+
#pragma once

#include <array>
#include <memory>

#include "sim/nature/trees/allometry.h"
#include "sim/render/content/content.h"

namespace rigor::nature {

struct AtlasCell {
  float u0, v0, u1, v1;  ///< v0: tip, v1: base
};
inline constexpr int kTwigCells = 4, kBoughCell = 4;
[[nodiscard]] constexpr AtlasCell atlas_cell(int cell) noexcept {
  if (cell == kBoughCell) return {0.5F, 0.0F, 1.0F, 1.0F};
  const float u = 0.25F * static_cast<float>(cell % 2), v = 0.5F * static_cast<float>(cell / 2);
  return {u, v, u + 0.25F, v + 0.5F};
}

/// Share of the visible light that reaches leaves inside a crown and under it.
inline constexpr float kInnerLight = 0.45F;
struct FoliageSurface {
  std::shared_ptr<const render::Surface> surface;
  std::shared_ptr<const render::Surface> inner;  ///< the same leaves in the shade of others
  std::array<float, 5> coverage;                 ///< of each cell: share of its area that is leaf
};

/// Made at the first call and shared from then on. Any thread. Reflectance and transmittance, averaged over
/// the covered texels, are those of `needles` or `broad_leaves` in sim/render/content/surface_library.h.
[[nodiscard]] const FoliageSurface& foliage_surface(TreeForm form);
/// As above; averages to `bark` (birch: white bark). One repeat of the picture is kBarkWidth_m around the
/// trunk and kBarkHeight_m along it.
[[nodiscard]] std::shared_ptr<const render::Surface> bark_surface(BarkStyle style);
inline constexpr float kBarkWidth_m = 0.7F, kBarkHeight_m = 1.4F;

}  // namespace rigor::nature
