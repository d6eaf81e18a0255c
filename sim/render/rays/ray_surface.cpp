#include "sim/render/rays/ray_surface.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/render/content/texels.h"
#include "sim/render/rays/shading.h"
#include "sim/render/rays/texel_cell.h"

namespace rigor::render {
namespace {

inline TexelCell cell_at(const Texture& t, float u, float v) noexcept {
  return cell_of(t.width, texels_about(u, t.width, t.repeat), texels_about(v, t.height, t.repeat));
}

inline float channel(const Texture& t, const TexelCell& c, const float* decode, std::size_t k) noexcept {
  float sum = 0;
  for (std::size_t i = 0; i < 4; ++i) sum += c.share[i] * decode[t.rgba[4 * c.at[i] + k]];
  return sum;
}

inline const float* decoder(const Texture& t) noexcept { return linear_of_bytes(t.srgb); }

}  // namespace

bool has_holes(const Surface& s) noexcept { return s.alpha_cutoff > 0 && usable(s.colour_map) != nullptr; }

RaySurface::RaySurface(std::shared_ptr<const Surface> wanted, std::shared_ptr<const LeafCover> cover)
    : surface(std::move(wanted)), holes(std::move(cover)) {
  if (!surface) {
    Surface grey;
    grey.name = "unknown";
    surface = std::make_shared<const Surface>(std::move(grey));
  }
  colour = usable(surface->colour_map);
  near_infrared = usable(surface->near_infrared_map);
  normal = usable(surface->normal_map);
  gloss = usable(surface->gloss_map);
  translucent = std::any_of(surface->transmittance.begin(), surface->transmittance.end(),
                            [](float t) { return t > 0; });
}

Eigen::Vector3f mapped_normal(const RaySurface& s, float u, float v) noexcept {
  if (s.normal == nullptr) return Eigen::Vector3f::UnitZ();
  const TexelCell c = cell_at(*s.normal, u, v);
  const float* const decode = decoder(*s.normal);
  Eigen::Vector3f m;
  for (std::size_t k = 0; k < 3; ++k)
    m[static_cast<Eigen::Index>(k)] = 2 * channel(*s.normal, c, decode, k) - 1;
  return m;
}

PointOptics optics_at(const RaySurface& r, const float uv[2], const float tint[3], const float normal[3],
                      const float place[3], const RayWeather& weather, std::span<const int> bands,
                      float* reflectance, float* transmittance) noexcept {
  const Surface& s = *r.surface;
  PointOptics o;
  o.roughness = std::clamp(s.roughness, 0.0F, 1.0F);
  o.metallic = std::clamp(s.metallic, 0.0F, 1.0F);
  o.retro_reflection = s.retro_reflection;
  o.water = s.water;
  if (r.gloss != nullptr)
    o.roughness *= 1.0F - 0.95F * channel(*r.gloss, cell_at(*r.gloss, uv[0], uv[1]), decoder(*r.gloss), 0);

  TexelCell colour_cell{}, infrared_cell{};
  if (r.colour != nullptr) colour_cell = cell_at(*r.colour, uv[0], uv[1]);
  if (r.near_infrared != nullptr) infrared_cell = cell_at(*r.near_infrared, uv[0], uv[1]);
  float mean = -1;
  for (std::size_t i = 0; i < bands.size(); ++i) {
    const auto b = static_cast<std::size_t>(bands[i]);
    float factor = 1;
    if (b < 3) {
      if (r.colour != nullptr) factor = channel(*r.colour, colour_cell, decoder(*r.colour), b);
      factor *= tint[b];
    } else {
      if (r.near_infrared != nullptr) {
        factor = channel(*r.near_infrared, infrared_cell, decoder(*r.near_infrared), b - 3);
      } else if (r.colour != nullptr) {
        if (mean < 0) {
          const float* const decode = decoder(*r.colour);
          mean = (channel(*r.colour, colour_cell, decode, 0) + channel(*r.colour, colour_cell, decode, 1) +
                  channel(*r.colour, colour_cell, decode, 2)) /
                 3.0F;
        }
        factor = mean;
      }
      factor *= (tint[0] + tint[1] + tint[2]) / 3.0F;
    }
    reflectance[i] = s.reflectance[b] * factor;
    transmittance[i] = s.transmittance[b] * factor;
  }

  if (weather.wetness > 0) {
    const float porosity = std::clamp(s.porosity, 0.0F, 1.0F);
    for (std::size_t i = 0; i < bands.size(); ++i)
      reflectance[i] *= light::wet_share(weather.wetness, porosity);
    o.roughness = light::wet_roughness(o.roughness, weather.wetness, porosity, normal[2]);
  }
  if (weather.snow_depth_m > 0 && s.takes_snow) {
    o.snow =
        light::snow_cover(light::from(place) + light::from(weather.cell), normal[2], weather.snow_depth_m);
    for (std::size_t i = 0; i < bands.size(); ++i) {
      reflectance[i] =
          light::mix(reflectance[i], kSnowReflectance[static_cast<std::size_t>(bands[i])], o.snow);
      transmittance[i] *= 1.0F - o.snow;
    }
    o.roughness = light::mix(o.roughness, 1.0F, o.snow);
    o.metallic *= 1.0F - o.snow;
    o.retro_reflection *= 1.0F - o.snow;
  }
  return o;
}

}  // namespace rigor::render
