#include "sim/render/view/occlusion.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/render/view/view_camera.h"

namespace rigor::render {

DepthTiles::DepthTiles(int width_px, int height_px, double near_m, std::span<const float> reversed)
    : columns_(count(width_px)), rows_(count(height_px)) {
  farthest_m_.reserve(reversed.size());
  for (const float d : reversed)
    farthest_m_.push_back(d > 0 ? static_cast<float>(near_m / static_cast<double>(d))
                                : std::numeric_limits<float>::infinity());
}

bool DepthTiles::hides(const ViewCamera& camera, const Eigen::Vector3d& c, double radius) const {
  const double x = camera.right.dot(c), y = camera.down.dot(c), z = camera.forward.dot(c);
  const double nearest = z - radius, farthest = z + radius;
  const Pinhole& p = camera.pinhole;
  if (!(nearest > p.near_m)) return false;
  // The box round the sphere, by its nearer or farther face, whichever reaches further out; a pixel of
  // margin.
  const auto low = [&](double v, double f, double centre) {
    const double edge = v - radius;
    return f * edge / (edge < 0 ? nearest : farthest) + centre - 0.5;
  };
  const auto high = [&](double v, double f, double centre) {
    const double edge = v + radius;
    return f * edge / (edge > 0 ? nearest : farthest) + centre + 1.5;
  };
  const auto tile = [](double px, int n) {
    return static_cast<int>(std::clamp(std::floor(px / kTile_px), 0.0, static_cast<double>(n - 1)));
  };
  const int x0 = tile(low(x, p.fx_px, p.cx_px), columns_), x1 = tile(high(x, p.fx_px, p.cx_px), columns_);
  const int y0 = tile(low(y, p.fy_px, p.cy_px), rows_), y1 = tile(high(y, p.fy_px, p.cy_px), rows_);
  const auto limit = static_cast<float>(nearest * 0.9999);
  for (int j = y0; j <= y1; ++j)
    for (int i = x0; i <= x1; ++i)
      if (!(farthest_m_[static_cast<std::size_t>(j * columns_ + i)] < limit)) return false;
  return true;
}

}  // namespace rigor::render
