#include "sim/sensors/camera/depth_blur.h"

#include <tbb/parallel_for.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "sim/sensors/camera/lens_samples.h"

namespace rigor {
namespace {

/// A sharp pixel: a disc that covers itself alone.
constexpr float kSharp_px = 0.5F;
/// Neighbours whose discs differ by less lie in one layer.
constexpr float kLayer_px = 0.5F;
constexpr int kTile_px = 8;
/// Discs up to this radius are gathered pixel by pixel; larger ones at every second, third … pixel.
constexpr float kDense_px = 4.5F;
constexpr int kSteps = 8;  ///< of the table of disc areas, per pixel of radius

/// How much of the pixel at this distance a disc with a soft edge covers.
float covers(float distance_px, float radius_px) {
  return std::clamp(radius_px + 0.5F - distance_px, 0.0F, 1.0F);
}

/// One over the sum of what a disc covers, by its radius: light is kept.
class DiscShare {
 public:
  DiscShare() {
    for (std::size_t i = 0; i < share_.size(); ++i) {
      const float r = std::max(static_cast<float>(i) / kSteps, kSharp_px);
      const int n = static_cast<int>(std::ceil(r)) + 1;
      float sum = 0;
      for (int y = -n; y <= n; ++y)
        for (int x = -n; x <= n; ++x) sum += covers(std::sqrt(static_cast<float>(x * x + y * y)), r);
      share_[i] = 1 / sum;
    }
  }
  [[nodiscard]] float operator()(float radius_px) const {
    return share_[static_cast<std::size_t>(radius_px * kSteps + 0.5F)];
  }

 private:
  std::array<float, static_cast<std::size_t>((kMaxBlurRadius_px + 1) * kSteps)> share_{};
};

struct Offset {
  int x, y;
  float distance;
};

/// Sums of one layer.
struct Layer {
  Eigen::Array4f light = Eigen::Array4f::Zero();
  float weight = 0;
  void add(float w, const float* radiance) {
    light += w * Eigen::Map<const Eigen::Array4f>(radiance);
    weight += w;
  }
};

}  // namespace

void blur_by_depth(const BlurPicture& in, int border_px, int first_band, int last_band, float* out) {
  static const DiscShare share;
  const int w = in.width_px, h = in.height_px;
  const int inner_w = w - 2 * border_px;
  const auto limit = static_cast<float>(std::min(border_px, kMaxBlurRadius_px));
  // How far a tile has to look: the largest disc that may reach it.
  const int tiles_x = (w + kTile_px - 1) / kTile_px, tiles_y = (h + kTile_px - 1) / kTile_px;
  std::vector<float> largest(static_cast<std::size_t>(tiles_x) * static_cast<std::size_t>(tiles_y), 0.0F);
  tbb::parallel_for(0, tiles_y, [&](int ty) {
    for (int v = ty * kTile_px; v < std::min((ty + 1) * kTile_px, h); ++v)
      for (int u = 0; u < w; ++u) {
        float& most = largest[static_cast<std::size_t>(ty * tiles_x + u / kTile_px)];
        const float r = std::abs(in.radius_px[static_cast<std::size_t>(v * w + u)]);
        if (r > most) most = r;  // false for NaN
      }
  });
  const int reach_tiles = (border_px + kTile_px - 1) / kTile_px;
  const auto reach_of = [&](int tx, int ty) {
    float reach = 0;
    for (int y = std::max(ty - reach_tiles, 0); y <= std::min(ty + reach_tiles, tiles_y - 1); ++y)
      for (int x = std::max(tx - reach_tiles, 0); x <= std::min(tx + reach_tiles, tiles_x - 1); ++x) {
        const float r = std::min(largest[static_cast<std::size_t>(y * tiles_x + x)], limit);
        const int gap = (std::max(std::max(std::abs(x - tx), std::abs(y - ty)), 1) - 1) * kTile_px;
        if (r + 0.5F > static_cast<float>(gap)) reach = std::max(reach, r);
      }
    return reach;
  };
  tbb::parallel_for(0, tiles_x * tiles_y, [&](int tile) {
    const int tx = tile % tiles_x, ty = tile / tiles_x;
    const int u0 = std::max(tx * kTile_px, border_px), u1 = std::min((tx + 1) * kTile_px, w - border_px);
    const int v0 = std::max(ty * kTile_px, border_px), v1 = std::min((ty + 1) * kTile_px, h - border_px);
    if (u0 >= u1 || v0 >= v1) return;
    const float reach = reach_of(tx, ty);
    const auto pixel_out = [&](int u, int v) {
      return out + 4 * (static_cast<std::size_t>(v - border_px) * static_cast<std::size_t>(inner_w) +
                        static_cast<std::size_t>(u - border_px));
    };
    if (reach <= kSharp_px) {
      for (int v = v0; v < v1; ++v)
        for (int u = u0; u < u1; ++u)
          std::copy_n(
              &in.radiance[4 * static_cast<std::size_t>(v * w + u) + static_cast<std::size_t>(first_band)],
              last_band - first_band, pixel_out(u, v) + first_band);
      return;
    }
    const int stride = reach <= kDense_px ? 1 : static_cast<int>(std::ceil(reach / kDense_px));
    const int n = static_cast<int>(std::floor(reach + 0.5F));
    for (int v = v0; v < v1; ++v)
      for (int u = u0; u < u1; ++u) {
        const auto at = static_cast<std::size_t>(v * w + u);
        float* const result = pixel_out(u, v);
        const float here = in.radius_px[at];
        if (std::isnan(here)) {
          for (int b = first_band; b < last_band; ++b) result[b] = 0;
          continue;
        }
        const float own = std::clamp(std::abs(here), kSharp_px, limit);
        const float own_share = share(own);
        Layer nearer, same, further;
        float further_within = 0;  // of what this pixel's own disc holds
        const auto take = [&](int x, int y) {
          const int qu = u + x, qv = v + y;
          if (qu < 0 || qv < 0 || qu >= w || qv >= h) return;
          const auto q = static_cast<std::size_t>(qv * w + qu);
          const float r = in.radius_px[q];
          if (std::isnan(r)) return;
          const float distance = std::sqrt(static_cast<float>(x * x + y * y));
          const float disc = std::clamp(std::abs(r), kSharp_px, limit);
          const float* const light = &in.radiance[4 * q];
          if (r > here + kLayer_px) {
            const float wide = std::max(disc, own), k = covers(distance, wide);
            if (k > 0) further.add(k * share(wide), light);
            further_within += covers(distance, own) * own_share;
          } else if (const float k = covers(distance, disc); k > 0) {
            (r < here - kLayer_px ? nearer : same).add(k * share(disc), light);
          }
        };
        if (stride == 1) {
          for (int y = -n; y <= n; ++y)
            for (int x = -n; x <= n; ++x) take(x, y);
        } else {
          // The lattice sits elsewhere for every pixel: what it misses is noise, not stripes.
          const std::uint32_t hash = scramble(static_cast<std::uint32_t>(at) * 0x9E3779B9U + 1U);
          const int x0 = static_cast<int>((hash & 0xFFFFU) % static_cast<std::uint32_t>(stride)),
                    y0 = static_cast<int>((hash >> 16) % static_cast<std::uint32_t>(stride));
          for (int y = -n / stride * stride - y0; y <= n; y += stride)
            for (int x = -n / stride * stride - x0; x <= n; x += stride) take(x, y);
          const auto area = static_cast<float>(stride * stride);
          for (Layer* l : {&nearer, &same, &further}) {
            l->light *= area;
            l->weight *= area;
          }
          further_within *= area;
          if (own < static_cast<float>(stride)) {  // the lattice hardly sees it
            same = {};
            same.add(1, &in.radiance[4 * at]);
            if (own <= kSharp_px) further_within = 0;
          }
        }
        if (!(same.weight > 0)) same.add(1, &in.radiance[4 * at]);
        Eigen::Array4f light = same.light / same.weight;
        if (further.weight > 0 && further_within > 0) {
          const float front = same.weight / (same.weight + further_within);
          light = front * light + (1 - front) * further.light / further.weight;
        }
        if (nearer.weight > 0) {
          const float cover = std::min(nearer.weight, 1.0F);
          light = (1 - cover) * light + cover * nearer.light / nearer.weight;
        }
        for (int b = first_band; b < last_band; ++b) result[b] = light[b];
      }
  });
}

}  // namespace rigor
