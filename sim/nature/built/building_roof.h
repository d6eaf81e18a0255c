// Roofs: closed shells that stand on the walls.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sim/nature/built/polygon.h"
#include "sim/nature/built/shell.h"

namespace rigor::nature::built {

enum class RoofShape : std::uint8_t { flat, gabled, hipped, pyramidal, shed };

struct RoofSpec {
  RoofShape shape = RoofShape::flat;
  double eaves_m = 6;     ///< z of the top of the walls
  double height_m = 3;    ///< ridge above eaves; of a flat roof: of the parapet, at most 0.4 m; 0: none
  double overhang_m = 0;  ///< of the eaves beyond the walls; outlines that are too narrow get none
};

/// What a facet of a roof is, as its tag.
enum RoofPart : int { kCovered, kGable, kFascia, kUnderside };

struct Roof {
  std::vector<Shell> shells;           ///< closed, each
  RoofShape shape = RoofShape::flat;   ///< what it became, where the wanted shape does not fit the footprint
  std::optional<Eigen::Vector3d> top;  ///< a highest point of a pitched roof
  std::vector<std::string> warnings;
};

[[nodiscard]] Roof make_roof(const Polygon& footprint, const RoofSpec& spec);

/// A polygon as a closed solid between two heights; sides tagged kGable, top kCovered, bottom kUnderside.
[[nodiscard]] Shell prism(const Polygon& polygon, double z0_m, double z1_m);

}  // namespace rigor::nature::built
