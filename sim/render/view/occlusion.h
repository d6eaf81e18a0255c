// What the solid things that have been drawn hide: the farthest depth of each tile of the picture. Internal
// to sim/render/view.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

namespace rigor::render {

struct ViewCamera;

class DepthTiles {
 public:
  static constexpr int kTile_px = 16;
  static int count(int px) { return (px + kTile_px - 1) / kTile_px; }

  /// `reversed`: the smallest value of the depth buffer in each tile, row by row; 0: the sky is seen there.
  DepthTiles(int width_px, int height_px, double near_m, std::span<const float> reversed);
  /// True only where every pixel that the sphere (relative to the eye) can touch has something in front of
  /// it.
  [[nodiscard]] bool hides(const ViewCamera& camera, const Eigen::Vector3d& centre, double radius_m) const;

 private:
  int columns_ = 0, rows_ = 0;
  std::vector<float> farthest_m_;
};

}  // namespace rigor::render
