// One square of the ground as an engine draws it: mesh, and the pictures of its reflectance.
#pragma once

#include <memory>

#include "sim/nature/terrain/height_tree.h"
#include "sim/render/content/content.h"

namespace rigor::nature {

/// Texels along a tile's side, all tiles; the outer rows of texels lie on the edges, so neighbours share
/// them.
inline constexpr int kTileTexels = 128;

/// The part of a node that is drawn, in blocks of 2^s cells, with skirts down to what any neighbour can show
/// on the shared edge. Positions are relative to `origin`. Null where nothing is drawn. The triangles of
/// rivers come last, from index `first_river_index` on.
struct TileMesh {
  std::shared_ptr<render::Mesh> mesh;
  std::uint32_t first_river_index = 0;
};
[[nodiscard]] TileMesh tile_mesh(const HeightTree& tree, const TreeNode& node, int s,
                                 const Eigen::Vector3d& origin);

/// What the ground of a node reflects: colour map and near-infrared map over a surface of reflectance 1.
/// `plain_imagery`: the imagery where there is some.
[[nodiscard]] std::shared_ptr<render::Surface> tile_surface(const HeightTree& tree, const TreeNode& node,
                                                            bool plain_imagery);

/// The flat sheet of a body of water, relative to `origin`; null where it has no area or is a river.
/// Cells of land cover reach one cell beyond their own, under the shore.
[[nodiscard]] std::shared_ptr<render::Mesh> water_mesh(const Ground& ground, const WaterBody& body,
                                                       const Eigen::Vector3d& origin);

}  // namespace rigor::nature
