#include "sim/sensors/tof/tof_filters.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor::tof {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

struct View {
  const float* z;
  int width, height;
  /// NaN outside.
  [[nodiscard]] float at(int u, int v) const {
    if (u < 0 || v < 0 || u >= width || v >= height) return kNaN;
    return z[static_cast<std::size_t>(v) * static_cast<std::size_t>(width) + static_cast<std::size_t>(u)];
  }
};

template <class F>
void each_pixel(const TofPicture& picture, const F& f) {
  tbb::parallel_for(
      tbb::blocked_range<int>(0, static_cast<int>(picture.height_px), 4), [&](const auto& range) {
        for (int v = range.begin(); v < range.end(); ++v)
          for (int u = 0; u < static_cast<int>(picture.width_px); ++u)
            f(u, v, static_cast<std::size_t>(v) * picture.width_px + static_cast<std::size_t>(u));
      });
}

/// A pixel between two surfaces: along one of the four lines through it its range lies between its
/// neighbours', further than the threshold from both, and beyond each neighbour the surface goes on with less
/// than half of that step. (On a slope it goes on with the same step.)
bool flies(const View& view, int u, int v, float threshold_m) {
  const float here = view.at(u, v);
  constexpr int kLines[4][2] = {{1, 0}, {0, 1}, {1, 1}, {1, -1}};
  for (const auto& line : kLines) {
    const float a = view.at(u - line[0], v - line[1]), b = view.at(u + line[0], v + line[1]);
    const float da = here - a, db = b - here;
    if (!(da * db > 0) || !(std::min(std::abs(da), std::abs(db)) > threshold_m)) continue;
    const float beyond_a = view.at(u - 2 * line[0], v - 2 * line[1]),
                beyond_b = view.at(u + 2 * line[0], v + 2 * line[1]);
    if (std::abs(a - beyond_a) > 0.5F * std::abs(da) || std::abs(beyond_b - b) > 0.5F * std::abs(db))
      continue;
    return true;
  }
  return false;
}

float median(const View& view, int u, int v, int side) {
  float window[25] = {};
  int count = 0;
  for (int dv = -side / 2; dv <= side / 2; ++dv)
    for (int du = -side / 2; du <= side / 2; ++du) {
      const float z = view.at(u + du, v + dv);
      if (!std::isnan(z)) window[count++] = z;
    }
  // Of an even number the lower one of the two in the middle: a range that was measured.
  float* middle = window + (count - 1) / 2;
  std::nth_element(window, middle, window + count);
  return *middle;
}

float bilateral(const View& view, int u, int v, const models::TofFilters& f) {
  const float here = view.at(u, v);
  const auto in_px = static_cast<float>(-0.5 / (f.bilateral_sigma_px * f.bilateral_sigma_px)),
             in_m = static_cast<float>(-0.5 / (f.bilateral_sigma_m * f.bilateral_sigma_m));
  float sum = 0, weights = 0;
  for (int dv = -f.bilateral_radius_px; dv <= f.bilateral_radius_px; ++dv)
    for (int du = -f.bilateral_radius_px; du <= f.bilateral_radius_px; ++du) {
      const float d = view.at(u + du, v + dv) - here;
      if (std::isnan(d)) continue;
      const float w = std::exp(static_cast<float>(du * du + dv * dv) * in_px + d * d * in_m);
      sum += w * d;
      weights += w;
    }
  return here + sum / weights;
}

}  // namespace

void filter(const models::TofFilters& filters, TofPicture& picture, std::vector<float>& scratch) {
  const auto source = [&] {
    scratch.assign(picture.range_m.begin(), picture.range_m.end());
    return View{scratch.data(), static_cast<int>(picture.width_px), static_cast<int>(picture.height_px)};
  };
  if (filters.flying_pixel_m > 0) {
    const View view = source();
    each_pixel(picture, [&](int u, int v, std::size_t i) {
      if (!flies(view, u, v, static_cast<float>(filters.flying_pixel_m))) return;
      picture.range_m[i] = kNaN;
      picture.status[i] = TofPixelStatus::filtered;
    });
  }
  if (filters.median_px > 0) {
    const View view = source();
    each_pixel(picture, [&](int u, int v, std::size_t i) {
      if (!std::isnan(view.z[i])) picture.range_m[i] = median(view, u, v, filters.median_px);
    });
  }
  if (filters.bilateral_radius_px > 0) {
    const View view = source();
    each_pixel(picture, [&](int u, int v, std::size_t i) {
      if (!std::isnan(view.z[i])) picture.range_m[i] = bilateral(view, u, v, filters);
    });
  }
}

}  // namespace rigor::tof
