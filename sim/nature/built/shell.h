// Triangles that share points: closed where a solid is meant, and mended where one side of an edge has more
// points than the other.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

namespace rigor::nature::built {

struct Facet {
  std::array<int, 3> corner{};  ///< anticlockwise from outside
  int tag = 0;                  ///< what its maker wants to know of it, e.g. the edge that it rose from
};
struct Shell {
  std::vector<Eigen::Vector3d> points;
  std::vector<Facet> facets;
};

/// A shell from loose triangles: points nearer than `same_m` become one, facets without area go, and an edge
/// that has more points on its other side is split at them. Order and result depend on the input alone.
[[nodiscard]] Shell weld(const std::vector<std::array<Eigen::Vector3d, 3>>& triangles,
                         const std::vector<int>& tags, double same_m);

/// Directed edges that no other facet runs along the other way. Empty: closed.
[[nodiscard]] std::vector<std::array<int, 2>> open_edges(const Shell& shell);
/// Of a closed shell, m³; normals outwards: above 0.
[[nodiscard]] double volume(const Shell& shell);

}  // namespace rigor::nature::built
