#include "sim/sensors/camera/uneven_pixels.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor {
namespace {

constexpr int kUnevenBlockWidth = 4, kUnevenBlockHeight = 2;

struct RadianceSpan {
  float least = std::numeric_limits<float>::infinity(), most = -std::numeric_limits<float>::infinity();
  void add(float v) {
    if (!std::isfinite(v)) return;
    least = std::min(least, v);
    most = std::max(most, v);
  }
};

}  // namespace

std::vector<PixelPlace> pixels_by_blocks(const OpticsRequest::Region& inner, int width_px, int height_px,
                                         const std::function<bool(int u, int v)>& wanted) {
  std::vector<PixelPlace> out;
  const int end_u = std::min(inner.x_px + inner.width_px, width_px),
            end_v = std::min(inner.y_px + inner.height_px, height_px);
  for (int v0 = inner.y_px; v0 < end_v; v0 += kUnevenBlockHeight)
    for (int u0 = inner.x_px; u0 < end_u; u0 += kUnevenBlockWidth)
      for (int v = v0; v < std::min(v0 + kUnevenBlockHeight, end_v); ++v)
        for (int u = u0; u < std::min(u0 + kUnevenBlockWidth, end_u); ++u)
          if (wanted(u, v)) out.push_back({u, v});
  return out;
}

std::vector<PixelPlace> uneven_pixels(const OpticsPicture& picture, const OpticsRequest::Region& inner,
                                      const std::array<float, 4>& mean, float contrast,
                                      const std::function<bool(int u, int v)>& lit) {
  const auto uneven = [&](int u, int v) {
    std::array<RadianceSpan, 4> spans;
    for (int y = std::max(v - 1, 0); y <= std::min(v + 1, picture.height_px - 1); ++y)
      for (int x = std::max(u - 1, 0); x <= std::min(u + 1, picture.width_px - 1); ++x) {
        if (!lit(x, y)) continue;
        const float* const p =
            &picture.radiance[4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
                                   static_cast<std::size_t>(x))];
        for (std::size_t b = 0; b < 4; ++b) spans[b].add(p[b]);
      }
    for (std::size_t b = 0; b < 4; ++b)
      if (mean[b] > 0 && spans[b].most - spans[b].least > contrast * mean[b]) return true;
    return false;
  };
  return pixels_by_blocks(inner, picture.width_px, picture.height_px,
                          [&](int u, int v) { return lit(u, v) && uneven(u, v); });
}

}  // namespace rigor
