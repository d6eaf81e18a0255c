// Roofs over any polygon: the outline shrinks, each edge at its own speed, and what it sweeps as it rises is
// the roof (the straight skeleton of Aichholzer et al. 1995, here with edges that may stand still: a gable is
// an edge of speed 0).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "sim/nature/built/polygon.h"
#include "sim/nature/built/shell.h"

namespace rigor::nature::built {

struct RoofSweep {
  /// x, y and, as z, the way [m] that an edge of speed 1 has come when the front is there. A facet's tag is
  /// the number of its edge.
  Shell shell;
  double height_m = 0;  ///< greatest z
  /// Of each edge: swept by one triangle (but for a hundredth of it), between neighbours that never changed:
  /// it can become a gable.
  std::vector<bool> is_hip_end;
};

/// `speeds`: one per edge, 0 or more. Empty where the fronts get entangled; what comes is whole: its
/// projection covers the polygon once, and its only open edges lie on the outline.
[[nodiscard]] std::optional<RoofSweep> sweep_roof(const Polygon& outline, std::span<const double> speeds);

/// Speeds with which sweep_roof makes gables of the ends of ridges: 0 for hip ends between walls that run
/// nearly parallel, 1 elsewhere. All 1 where there is no such end.
[[nodiscard]] std::vector<double> gable_speeds(const Polygon& outline, const RoofSweep& hipped);

}  // namespace rigor::nature::built
