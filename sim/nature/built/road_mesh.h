// Roads: bands that lie on the ground, with a crown, lane markings where they are wide, and skirts into the
// ground.
#pragma once

#include <functional>
#include <memory>
#include <string_view>
#include <vector>

#include "sim/nature/built/ribbon.h"
#include "sim/render/content/content.h"

namespace rigor::nature::built {

enum class RoadSurface : std::uint8_t { asphalt, concrete, gravel, soil };

struct RoadSpec {
  Line line;  ///< relative to an origin near it
  double width_m = 5;
  RoadSurface surface = RoadSurface::asphalt;
  /// z of the ground in the same frame; NaN: unknown (then as its surroundings, 0 where nothing is known).
  std::function<double(const Eigen::Vector2d&)> ground{};
  std::shared_ptr<const render::Surface> own_cover{};  ///< in place of what `surface` means; unmarked
};

/// A part of a road: some hundred metres, so that what is not seen need not be drawn.
struct RoadPiece {
  Eigen::Vector3d origin;  ///< relative to the line's origin
  std::shared_ptr<const render::Mesh> mesh;
};

[[nodiscard]] std::vector<RoadPiece> make_road(const RoadSpec& spec);

}  // namespace rigor::nature::built
