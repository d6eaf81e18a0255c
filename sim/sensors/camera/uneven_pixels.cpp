#include "sim/sensors/camera/uneven_pixels.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Core>
#include <algorithm>
#include <limits>

namespace rigor {
namespace {

constexpr float kNone = std::numeric_limits<float>::infinity();

/// Of each pixel of a row, the least and the most of each band among it and its neighbours to both sides.
struct RowSpans {
  std::vector<Eigen::Array4f> least, most;

  void fill(const OpticsPicture& picture, int v, const std::function<bool(int u, int v)>& lit) {
    const auto width = static_cast<std::size_t>(picture.width_px);
    least.assign(width, Eigen::Array4f::Constant(kNone));
    most.assign(width, Eigen::Array4f::Constant(-kNone));
    if (v < 0 || v >= picture.height_px) return;
    const float* const row = &picture.radiance[4 * static_cast<std::size_t>(v) * width];
    for (std::size_t u = 0; u < width; ++u) {
      if (!lit(static_cast<int>(u), v)) continue;
      const Eigen::Array4f p = Eigen::Map<const Eigen::Array4f>(&row[4 * u]);
      const auto finite = p.abs() < kNone;  // a NaN is not
      const Eigen::Array4f low = finite.select(p, kNone), high = finite.select(p, -kNone);
      for (std::size_t k = u > 0 ? u - 1 : u; k <= std::min(u + 1, width - 1); ++k) {
        least[k] = least[k].min(low);
        most[k] = most[k].max(high);
      }
    }
  }
};

}  // namespace

std::vector<PixelPlace> pixels_by_blocks(const OpticsRequest::Region& inner, int width_px, int height_px,
                                         std::span<const std::uint8_t> wanted) {
  std::vector<PixelPlace> out;
  const int end_u = std::min(inner.x_px + inner.width_px, width_px),
            end_v = std::min(inner.y_px + inner.height_px, height_px);
  for (int v0 = inner.y_px; v0 < end_v; v0 += kPacketHeight_px)
    for (int u0 = inner.x_px; u0 < end_u; u0 += kPacketWidth_px)
      for (int v = v0; v < std::min(v0 + kPacketHeight_px, end_v); ++v)
        for (int u = u0; u < std::min(u0 + kPacketWidth_px, end_u); ++u)
          if (wanted[static_cast<std::size_t>(v) * static_cast<std::size_t>(width_px) +
                     static_cast<std::size_t>(u)] != 0)
            out.push_back({u, v});
  return out;
}

std::vector<PixelPlace> uneven_pixels(const OpticsPicture& picture, const OpticsRequest::Region& inner,
                                      const std::array<float, 4>& mean, float contrast,
                                      const std::function<bool(int u, int v)>& lit) {
  Eigen::Array4f limit;
  for (int b = 0; b < 4; ++b) {
    const float m = mean[static_cast<std::size_t>(b)];
    limit[b] = m > 0 ? contrast * m : kNone;
  }
  const auto width = static_cast<std::size_t>(picture.width_px);
  std::vector<std::uint8_t> uneven(width * static_cast<std::size_t>(picture.height_px));
  const int first_u = std::max(inner.x_px, 0), first_v = std::max(inner.y_px, 0),
            end_u = std::min(inner.x_px + inner.width_px, picture.width_px),
            end_v = std::min(inner.y_px + inner.height_px, picture.height_px);
  constexpr int kRowsAtOnce = 16;
  tbb::parallel_for(
      tbb::blocked_range<int>(first_v, std::max(first_v, end_v), kRowsAtOnce),
      [&](const tbb::blocked_range<int>& rows) {
        RowSpans spans[3];
        for (const int v : {rows.begin() - 1, rows.begin()})
          spans[static_cast<unsigned>(v + 3) % 3].fill(picture, v, lit);
        for (int v = rows.begin(); v < rows.end(); ++v) {
          spans[static_cast<unsigned>(v + 4) % 3].fill(picture, v + 1, lit);
          for (int u = first_u; u < end_u; ++u) {
            const auto i = static_cast<std::size_t>(u);
            const Eigen::Array4f least = spans[0].least[i].min(spans[1].least[i]).min(spans[2].least[i]),
                                 most = spans[0].most[i].max(spans[1].most[i]).max(spans[2].most[i]);
            if ((most - least > limit).any() && lit(u, v))
              uneven[static_cast<std::size_t>(v) * width + i] = 1;
          }
        }
      });
  return pixels_by_blocks(inner, picture.width_px, picture.height_px, uneven);
}

}  // namespace rigor
