// Where the eye is and what it can see, in double; and places relative to it. Internal to sim/render/view.
#pragma once

#include <Eigen/Geometry>
#include <array>

#include "sim/render/view/resident_content.h"
#include "sim/render/view/view_renderer.h"

namespace rigor::render {

struct ViewCamera {
  Eigen::Vector3d eye, right, down, forward;  ///< world frame
  Pinhole pinhole;
  /// n·p + d ≥ 0 inside, p relative to the eye: left, right, top, bottom, near.
  std::array<Eigen::Vector4d, 5> planes;
  double focal_px = 1;  ///< the larger one

  explicit ViewCamera(const ViewRequest& request);
  /// Edges of the picture as tangents: left, right, top, bottom.
  [[nodiscard]] std::array<double, 4> edges() const;
};

enum class Seen : std::uint8_t { outside, partly, inside };
/// `box`: world frame.
[[nodiscard]] Seen seen(const ViewCamera& camera, const Eigen::AlignedBox3d& box, double margin_m);

}  // namespace rigor::render
