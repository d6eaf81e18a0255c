// Which pinhole views hold a set of rays that share an origin: one where they lie in a cone, else the sides
// of a box about their axis, each cut to what its rays use. Internal to sim/render/view.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "sim/render/engine/ray_engine.h"
#include "sim/render/view/view_renderer.h"

namespace rigor::render {

struct RayFace {
  Eigen::Matrix3d R_world_face;  ///< columns: right, down, forward
  Pinhole pinhole;
  std::vector<std::uint32_t> rays;  ///< indices
  std::vector<std::array<float, 2>>
      at_px;  ///< where each goes through the view, a texel from its edge at least
};

struct FaceOptions {
  double pixels_per_rad = 500;  ///< at the middle of a face
  double near_m = 0.001;        ///< range from which on things are seen
  int largest_side_px = 2048;   ///< larger ones are split
};

/// Rays of a cone up to this half angle are one view.
inline constexpr double kOneView_rad = 0.87;

/// `which`: indices into `rays`, each of them of unit length. Faces without rays are left out.
[[nodiscard]] std::vector<RayFace> faces_for(std::span<const Ray> rays, std::span<const std::uint32_t> which,
                                             const FaceOptions& options);

}  // namespace rigor::render
