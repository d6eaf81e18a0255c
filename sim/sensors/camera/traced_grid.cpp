#include "sim/sensors/camera/traced_grid.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "sim/sensors/camera/uneven_pixels.h"

namespace rigor {
namespace {

constexpr int kWidestBorder_px = 64;

CameraModel coarse(CameraModel camera, int step) {
  const double s = step;
  camera.width_px = (camera.width_px + step - 1) / step;
  camera.height_px = (camera.height_px + step - 1) / step;
  camera.fx_px /= s;
  camera.fy_px /= s;
  camera.cx_px = (camera.cx_px - 0.5 * (s - 1)) / s;
  camera.cy_px = (camera.cy_px - 0.5 * (s - 1)) / s;
  return camera;
}

/// How far beyond the sensor a colour's picture is taken from, in whole blocks of coarse pixels: a place p
/// shows what the reference has at c + (p − c)/m.
int border_of(const CameraModel& camera, int step) {
  double most = 0;
  for (const double m : camera.chromatic.magnification)
    for (const double side : {camera.cx_px, camera.cy_px, camera.width_px - 1 - camera.cx_px,
                              camera.height_px - 1 - camera.cy_px})
      most = std::max(most, std::abs(side * (1 / m - 1)) / step);
  if (!(most < 1e4)) return kWidestBorder_px + 1;
  const int blocks = static_cast<int>(std::ceil((most + 1) / kPacketWidth_px));
  return blocks * kPacketWidth_px;
}

}  // namespace

TracedGrid::TracedGrid(const CameraModel& camera, int step)
    : camera_(coarse(camera, step)), sensor_(camera), step_(step), border_(border_of(camera, step)) {}

bool TracedGrid::fits(const CameraModel& camera, int step) {
  return border_of(camera, step) <= kWidestBorder_px;
}

OpticsRequest::Region TracedGrid::looked_at(const OpticsRequest::Region& region) const {
  const auto span = [&](int first, int count, double centre, int size, int& low, int& n) {
    double least = first, most = first + count - 1;
    for (const double m : sensor_.chromatic.magnification)
      for (const double p : {static_cast<double>(first), static_cast<double>(first + count - 1)}) {
        least = std::min(least, centre + (p - centre) / m);
        most = std::max(most, centre + (p - centre) / m);
      }
    low = std::clamp(static_cast<int>(std::floor(traced_at(least))), 0, size - 1);
    n = std::clamp(static_cast<int>(std::floor(traced_at(most))) + 1, low, size - 1) - low + 1;
  };
  OpticsRequest::Region out;
  span(region.x_px, region.width_px, sensor_.cx_px, width_px(), out.x_px, out.width_px);
  span(region.y_px, region.height_px, sensor_.cy_px, height_px(), out.y_px, out.height_px);
  return out;
}

void TracedGrid::move_colours(const OpticsPicture& reference, const OpticsRequest::Region& traced,
                              const LensGrid& lens, const OpticsRequest::Region& region,
                              OpticsPicture& out) const {
  struct Between {
    int low = 0, high = 0;
    float share = 0;
  };
  // Along one axis: which two of the reference's pixels a colour's pixel lies between.
  const auto along = [&](double centre, double m, int first, int count, int from, int size) {
    std::vector<Between> all(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i) {
      const double at = traced_at(centre + (first + i - centre) / m) - from;
      const double low = std::floor(at);
      all[static_cast<std::size_t>(i)] = {std::clamp(static_cast<int>(low), 0, size - 1),
                                          std::clamp(static_cast<int>(low) + 1, 0, size - 1),
                                          static_cast<float>(at - low)};
    }
    return all;
  };
  const auto& magnification = sensor_.chromatic.magnification;
  for (std::size_t first = 0, end = 0; first < 3; first = end) {
    // Colours that lie at the same places are moved at once; near infrared goes with red.
    const double m = magnification[first];
    for (end = first + 1; end < 3 && magnification[end] == m;) ++end;
    const auto columns = along(sensor_.cx_px, m, region.x_px, region.width_px, traced.x_px, traced.width_px);
    const auto rows = along(sensor_.cy_px, m, region.y_px, region.height_px, traced.y_px, traced.height_px);
    tbb::parallel_for(0, region.height_px, [&](int y) {
      const Between& v = rows[static_cast<std::size_t>(y)];
      for (int x = 0; x < region.width_px; ++x) {
        const Between& u = columns[static_cast<std::size_t>(x)];
        // Where the lens sends no light there is none to mix in.
        Eigen::Array4f light = Eigen::Array4f::Zero();
        float weight = 0;
        const auto add = [&](int i, int j, float w) {
          if (!(w > 0) || !lens.at(traced.x_px + i - border_, traced.y_px + j - border_).lit()) return;
          light += w * Eigen::Map<const Eigen::Array4f>(
                           &reference.radiance[4 * (static_cast<std::size_t>(j) *
                                                        static_cast<std::size_t>(traced.width_px) +
                                                    static_cast<std::size_t>(i))]);
          weight += w;
        };
        add(u.low, v.low, (1 - u.share) * (1 - v.share));
        add(u.high, v.low, u.share * (1 - v.share));
        add(u.low, v.high, (1 - u.share) * v.share);
        add(u.high, v.high, u.share * v.share);
        if (!(weight > 0)) continue;
        light /= weight;
        float* const p =
            &out.radiance[4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(region.width_px) +
                               static_cast<std::size_t>(x))];
        for (std::size_t c = first; c < end; ++c) p[c] = light[static_cast<Eigen::Index>(c)];
        if (first == 0) p[3] = light[3];
      }
    });
  }
}

}  // namespace rigor
