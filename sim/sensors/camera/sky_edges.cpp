#include "sim/sensors/camera/sky_edges.h"

#include <algorithm>
#include <cmath>

namespace rigor {

template <class F>
void SkyEdges::about(PixelPlace at, F&& f) const {
  for (int v = std::max(at.v - 1, 0); v <= std::min(at.v + 1, height_px_ - 1); ++v)
    for (int u = std::max(at.u - 1, 0); u <= std::min(at.u + 1, width_px_ - 1); ++u)
      f(pixels_[index({u, v})]);
}

void SkyEdges::reset(int width_px, int height_px) {
  width_px_ = width_px;
  height_px_ = height_px;
  pixels_.assign(static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px), {});
}

void SkyEdges::add(PixelPlace at, const render::LightSample& s) {
  add_sky_only(at, s);
  if (std::isinf(s.range_m)) return;
  Pixel& p = pixels_[index(at)];
  for (std::size_t b = 0; b < 4; ++b) p.surface[b] += s.radiance[b];
  p.surfaces += 1;
}

void SkyEdges::add_sky_only(PixelPlace at, const render::LightSample& s) {
  Pixel& p = pixels_[index(at)];
  if (!std::isinf(s.range_m)) {
    p.met += 1;
    return;
  }
  for (std::size_t b = 0; b < 4; ++b) p.sky[b] += s.radiance[b];
  p.skies += 1;
}

std::vector<PixelPlace> SkyEdges::places(const OpticsRequest::Region& inner,
                                         const std::function<bool(int u, int v)>& lit) const {
  return pixels_by_blocks(inner, width_px_, height_px_, [&](int u, int v) {
    if (!lit(u, v)) return false;
    bool sky = false, surface = false;
    about({u, v}, [&](const Pixel& p) {
      sky = sky || p.skies > 0;
      surface = surface || p.met > 0;
    });
    return sky && surface;
  });
}

void SkyEdges::resolve(PixelPlace at, float radiance[4]) const {
  const Pixel& own = pixels_[index(at)];
  const float all = own.skies + own.met;
  if (!(all > 0)) return;
  Pixel lit = own;
  if (own.met > 0 && !(own.surfaces > 0))
    about(at, [&](const Pixel& p) {
      for (std::size_t b = 0; b < 4; ++b) lit.surface[b] += p.surface[b];
      lit.surfaces += p.surfaces;
    });
  // Where nobody near knows how bright the surfaces are they have no say.
  const float met = lit.surfaces > 0 ? own.met : 0, weight = own.skies + met;
  if (!(weight > 0)) return;
  for (std::size_t b = 0; b < 4; ++b)
    radiance[b] = (own.sky[b] + (met > 0 ? met * lit.surface[b] / lit.surfaces : 0.0F)) / weight;
}

}  // namespace rigor
