#include "sim/sensors/camera/sky_edges.h"

#include <algorithm>
#include <cmath>

namespace rigor {

template <class F>
void SkyEdges::about(PixelPlace at, F&& f) const {
  for (int v = std::max(at.v - 1, 0); v <= std::min(at.v + 1, height_px_ - 1); ++v)
    for (int u = std::max(at.u - 1, 0); u <= std::min(at.u + 1, width_px_ - 1); ++u)
      if (met_[index({u, v})] != 0) f(pixels_[index({u, v})]);
}

void SkyEdges::reset(int width_px, int height_px) {
  width_px_ = width_px;
  height_px_ = height_px;
  const std::size_t pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  met_.assign(pixels, 0);
  pixels_.resize(pixels);
}

void SkyEdges::add(PixelPlace at, const render::LightSample& s) {
  Pixel& p = count(at, s, 0);
  if (s.sky_share > 0) return;
  for (std::size_t b = 0; b < 4; ++b) p.surface[b] += s.radiance[b];
  p.surfaces += 1;
}

void SkyEdges::add_sky_only(PixelPlace at, const render::LightSample& s) { count(at, s, kAsked); }

SkyEdges::Pixel& SkyEdges::count(PixelPlace at, const render::LightSample& s, std::uint8_t asked) {
  const std::size_t i = index(at);
  Pixel& p = pixels_[i];
  if (met_[i] == 0) p = {};
  met_[i] |= asked;
  if (s.sky_share > 0) met_[i] |= kSky;
  if (s.sky_share < 1) met_[i] |= kSurface;
  for (std::size_t b = 0; b < 4; ++b) p.sky[b] += s.sky_share * s.radiance[b];
  p.skies += s.sky_share;
  p.met += 1 - s.sky_share;
  return p;
}

std::vector<PixelPlace> SkyEdges::places(const OpticsRequest::Region& inner,
                                         const std::function<bool(int u, int v)>& lit) const {
  if (std::none_of(met_.begin(), met_.end(), [](std::uint8_t m) { return (m & kSky) != 0; })) return {};
  std::vector<std::uint8_t> edges(met_.size()), column(static_cast<std::size_t>(width_px_) + 2);
  for (int v = std::max(inner.y_px, 0); v < std::min(inner.y_px + inner.height_px, height_px_); ++v) {
    const std::uint8_t *const above = &met_[index({0, std::max(v - 1, 0)})],
                              *const own = &met_[index({0, v})],
                              *const below = &met_[index({0, std::min(v + 1, height_px_ - 1)})];
    for (std::size_t u = 0; u + 2 < column.size(); ++u) column[u + 1] = above[u] | own[u] | below[u];
    for (int u = std::max(inner.x_px, 0); u < std::min(inner.x_px + inner.width_px, width_px_); ++u) {
      const auto i = static_cast<std::size_t>(u);
      const auto met = static_cast<unsigned>(column[i] | column[i + 1] | column[i + 2]);
      if ((met & kBoth) == kBoth && (own[i] & kAsked) == 0 && lit(u, v)) edges[index({u, v})] = 1;
    }
  }
  return pixels_by_blocks(inner, width_px_, height_px_, edges);
}

void SkyEdges::resolve(PixelPlace at, float radiance[4]) const {
  if (met_[index(at)] == 0) return;
  const Pixel& own = pixels_[index(at)];
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
