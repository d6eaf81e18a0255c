// One wall of a house as part of a closed solid: a rectangle whose outer edges have no points of their own,
// so that it fits its neighbours, with openings set into it.
#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "sim/nature/built/built_surfaces.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::nature::built {

/// In the wall's plane: x along it, seen from outside to the right, z up.
struct Opening {
  double x0_m = 0, x1_m = 1, z0_m = 0, z1_m = 1;
  bool door = false;
};

struct WallSpec {
  Eigen::Vector2d from = Eigen::Vector2d::Zero(), to = Eigen::Vector2d::UnitX();  ///< outside is on the right
  double z0_m = 0, z1_m = 3;
  Cover cover;
  /// Strictly inside the rectangle, apart from each other.
  std::vector<Opening> openings{};
  double inset_m = 0.12;  ///< how deep panes lie; 0: flush
};

void add_wall(render::MeshBuilder& mesh, const WallSpec& wall);

}  // namespace rigor::nature::built
