#include "sim/sensors/camera/depth_blur.h"

#include <tbb/parallel_for.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "sim/sensors/camera/lens_samples.h"

namespace rigor {
namespace {

/// A sharp pixel: a disc that covers itself alone.
constexpr float kSharp_px = 0.5F;
/// Neighbours whose discs differ by less lie in one layer.
constexpr float kLayer_px = 0.5F;
constexpr int kTile_px = 8;
constexpr int kSteps = 16;  ///< of the table of discs, per pixel of radius

/// How much of the pixel at this distance a disc with a soft edge covers.
float covers(float distance_px, float radius_px) {
  return std::clamp(radius_px + 0.5F - distance_px, 0.0F, 1.0F);
}

/// What a disc puts on the pixels round it, by its radius. On a grid, the radius at which the soft edge is
/// drawn is the one that gives the disc its variance, r²/4 along each side; light is kept.
class Discs {
 public:
  Discs() {
    for (std::size_t i = 0; i < drawn_.size(); ++i) {
      const float wanted = static_cast<float>(i * i) / (4.0F * kSteps * kSteps);
      float low = kSharp_px, high = static_cast<float>(i) / kSteps + 1;
      for (int round = 0; round < 24; ++round) {
        const float middle = 0.5F * (low + high);
        (variance(middle).first < wanted ? low : high) = middle;
      }
      drawn_[i] = low;
      share_[i] = 1 / variance(low).second;
    }
  }
  struct Disc {
    float radius, share;
  };
  [[nodiscard]] Disc of(float radius_px) const {
    const auto i = static_cast<std::size_t>(radius_px * kSteps + 0.5F);
    return {drawn_[i], share_[i]};
  }

 private:
  static std::pair<float, float> variance(float radius) {
    const int n = static_cast<int>(std::ceil(radius)) + 1;
    float sum = 0, square = 0;
    for (int y = -n; y <= n; ++y)
      for (int x = -n; x <= n; ++x) {
        const float k = covers(std::sqrt(static_cast<float>(x * x + y * y)), radius);
        sum += k;
        square += k * static_cast<float>(x * x);
      }
    return {square / sum, sum};
  }
  static constexpr std::size_t kSize = (kMaxBlurRadius_px + 1) * kSteps;
  std::array<float, kSize> drawn_{}, share_{};
};

/// Where a tile looks: cells of pixels, one of which stands for all of them.
struct Pattern {
  int dense_px;  ///< up to here to each side every pixel is looked at
  int cell_px;   ///< beyond, one in a square of this side: odd, so that cells fit round what is dense
};
Pattern pattern_for(float reach_px) {
  if (reach_px <= 4.5F) return {5, 1};
  if (reach_px <= 13.5F) return {4, 3};
  return {2, 5};
}

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
  static const Discs discs;
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
    const Pattern pattern = pattern_for(reach);
    const int n = static_cast<int>(std::floor(reach + 0.5F)) + 1;
    for (int v = v0; v < v1; ++v)
      for (int u = u0; u < u1; ++u) {
        const auto at = static_cast<std::size_t>(v * w + u);
        float* const result = pixel_out(u, v);
        const float here = in.radius_px[at];
        if (std::isnan(here)) {
          for (int b = first_band; b < last_band; ++b) result[b] = 0;
          continue;
        }
        const Discs::Disc own = discs.of(std::min(std::abs(here), limit));
        Layer nearer, same, further;
        float further_within = 0;  // of what this pixel's own disc holds
        const auto take = [&](int x, int y, float area) {
          const int qu = u + x, qv = v + y;
          if (qu < 0 || qv < 0 || qu >= w || qv >= h) return;
          const auto q = static_cast<std::size_t>(qv * w + qu);
          const float r = in.radius_px[q];
          if (std::isnan(r)) return;
          const float distance = std::sqrt(static_cast<float>(x * x + y * y));
          const Discs::Disc disc = discs.of(std::min(std::abs(r), limit));
          const float* const light = &in.radiance[4 * q];
          if (r > here + kLayer_px) {
            const Discs::Disc wide = disc.radius > own.radius ? disc : own;
            if (const float k = covers(distance, wide.radius); k > 0)
              further.add(area * k * wide.share, light);
            further_within += area * covers(distance, own.radius) * own.share;
          } else if (const float k = covers(distance, disc.radius); k > 0) {
            (r < here - kLayer_px ? nearer : same).add(area * k * disc.share, light);
          }
        };
        const int dense = std::min(pattern.dense_px, n);
        for (int y = -dense; y <= dense; ++y)
          for (int x = -dense; x <= dense; ++x) take(x, y, 1);
        if (n > dense) {
          // The one pixel of a cell sits elsewhere for every pixel: what is missed is noise, not stripes.
          const std::uint32_t hash = scramble(static_cast<std::uint32_t>(at) * 0x9E3779B9U + 1U);
          const int cell = pattern.cell_px, half = cell / 2;
          const int x0 = static_cast<int>((hash & 0xFFFFU) % static_cast<std::uint32_t>(cell)) - half,
                    y0 = static_cast<int>((hash >> 16) % static_cast<std::uint32_t>(cell)) - half;
          const int cells = (n + half) / cell;
          for (int j = -cells; j <= cells; ++j)
            for (int i = -cells; i <= cells; ++i)
              if (std::max(std::abs(i), std::abs(j)) * cell > dense)
                take(i * cell + x0, j * cell + y0, static_cast<float>(cell * cell));
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
