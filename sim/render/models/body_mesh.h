// Shapes of Body and GroundPlane nodes.
#pragma once

#include <memory>

#include "sim/render/content/content.h"

namespace rigor::render {

using SurfacePtr = std::shared_ptr<const Surface>;

/// Inner corners, as sim/world/scene.h numbers them: on the +z face, centred. The square at the least x and y
/// is light; a board that is larger than its face is cut off there.
struct ChessboardSpec {
  int columns = 0, rows = 0;
  double square_m = 0.1;
  SurfacePtr dark;
};
[[nodiscard]] std::shared_ptr<const Mesh> box_mesh(const Eigen::Vector3d& size_m, const SurfacePtr& surface);
[[nodiscard]] std::shared_ptr<const Mesh> chessboard_mesh(const Eigen::Vector3d& size_m,
                                                          const SurfacePtr& surface,
                                                          const ChessboardSpec& board);
/// About z; size is diameter, diameter, height.
[[nodiscard]] std::shared_ptr<const Mesh> cylinder_mesh(const Eigen::Vector3d& size_m,
                                                        const SurfacePtr& surface);

struct GroundPlaneSpec {
  double half_extent_m = 100, cell_m = 1, noise_contrast = 0;
  SurfacePtr even, odd;  ///< cell (i, j) from the origin is odd where i + j is
};
/// The two materials and the noise as one surface whose pictures repeat after `repeat_m`.
struct GroundSurface {
  SurfacePtr surface;
  double repeat_m = 1;
};
[[nodiscard]] GroundSurface ground_surface(const GroundPlaneSpec& spec);
[[nodiscard]] std::shared_ptr<const Mesh> ground_mesh(const GroundPlaneSpec& spec);

}  // namespace rigor::render
