#include "sim/render/rays/ray_surface.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/render/rays/texel_cell.h"

namespace rigor::render {
namespace {

/// As the Vulkan engine's textures decode them (IEC 61966-2-1), by byte.
struct Decoders {
  std::array<float, 256> srgb{}, linear{};
  Decoders() {
    for (std::size_t i = 0; i < 256; ++i) {
      const float v = static_cast<float>(i) / 255.0F;
      linear[i] = v;
      srgb[i] = v <= 0.04045F ? v / 12.92F : std::pow((v + 0.055F) / 1.055F, 2.4F);
    }
  }
};
const Decoders kDecoders;

using Cell = TexelCell;

inline Cell cell_at(const Texture& t, float u, float v) noexcept {
  return cell_of(t.width, texels_about(u, t.width, t.repeat), texels_about(v, t.height, t.repeat));
}

inline float channel(const Texture& t, const Cell& c, const std::array<float, 256>& decode,
                     std::size_t k) noexcept {
  float sum = 0;
  for (std::size_t i = 0; i < 4; ++i) sum += c.share[i] * decode[t.rgba[4 * c.at[i] + k]];
  return sum;
}

inline const std::array<float, 256>& decoder(const Texture& t) noexcept {
  return t.srgb ? kDecoders.srgb : kDecoders.linear;
}

// noise.glsl
std::uint32_t pcg(std::uint32_t v) noexcept {
  const std::uint32_t state = v * 747796405U + 2891336453U;
  const std::uint32_t word = ((state >> ((state >> 28U) + 4U)) ^ state) * 277803737U;
  return (word >> 22U) ^ word;
}
float corner(std::int32_t x, std::int32_t y, std::int32_t z) noexcept {
  const auto c = [](std::int32_t i) { return static_cast<std::uint32_t>(i) & 1023U; };
  return static_cast<float>(pcg(c(x) + 1024U * c(y) + 1048576U * c(z)) >> 8U) / 16777216.0F;
}
float mix(float a, float b, float t) noexcept { return a + (b - a) * t; }
float smooth_noise(const Eigen::Vector3f& p) noexcept {
  if (!(p.cwiseAbs().maxCoeff() < 1e9F)) return 0.5F;
  const Eigen::Vector3f base(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
  Eigen::Vector3f f = p - base;
  for (int i = 0; i < 3; ++i) f[i] = f[i] * f[i] * (3.0F - 2.0F * f[i]);
  const Eigen::Vector3i c = base.cast<std::int32_t>();
  float row[2];
  for (int j = 0; j < 2; ++j) {
    float ends[2];
    for (int i = 0; i < 2; ++i)
      ends[i] = mix(corner(c.x() + i, c.y() + j, c.z()), corner(c.x() + i, c.y() + j, c.z() + 1), f.z());
    row[j] = mix(ends[0], ends[1], f.x());
  }
  return mix(row[0], row[1], f.y());
}
float smoothstep(float low, float high, float x) noexcept {
  const float t = std::clamp((x - low) / (high - low), 0.0F, 1.0F);
  return t * t * (3.0F - 2.0F * t);
}

}  // namespace

const Texture* usable(const std::shared_ptr<const Texture>& t) noexcept {
  const bool there = t && t->width > 0 && t->height > 0 &&
                     t->rgba.size() >= static_cast<std::size_t>(t->width) * t->height * 4;
  return there ? t.get() : nullptr;
}

RaySurface::RaySurface(std::shared_ptr<const Surface> wanted) : surface(std::move(wanted)) {
  if (!surface) {
    Surface grey;
    grey.name = "unknown";
    surface = std::make_shared<const Surface>(std::move(grey));
  }
  colour = usable(surface->colour_map);
  near_infrared = usable(surface->near_infrared_map);
  normal = usable(surface->normal_map);
  gloss = usable(surface->gloss_map);
  if (surface->alpha_cutoff > 0 && colour != nullptr) holes.emplace(*colour, surface->alpha_cutoff);
  translucent = std::any_of(surface->transmittance.begin(), surface->transmittance.end(),
                            [](float t) { return t > 0; });
}

Eigen::Vector3f mapped_normal(const RaySurface& s, float u, float v) noexcept {
  if (s.normal == nullptr) return Eigen::Vector3f::UnitZ();
  const Cell c = cell_at(*s.normal, u, v);
  const auto& decode = decoder(*s.normal);
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

  Cell colour_cell{}, infrared_cell{};
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
          const auto& decode = decoder(*r.colour);
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

  // surface_light.glsl: leaving()
  if (weather.wetness > 0) {
    const float porosity = std::clamp(s.porosity, 0.0F, 1.0F), wet = weather.wetness;
    for (std::size_t i = 0; i < bands.size(); ++i) reflectance[i] *= 1.0F - 0.55F * wet * porosity;
    o.roughness = mix(o.roughness, 0.15F,
                      wet * (0.35F + 0.65F * std::clamp(normal[2], 0.0F, 1.0F)) * (1.0F - 0.5F * porosity));
  }
  if (weather.snow_depth_m > 0 && s.takes_snow) {
    const Eigen::Vector3f at(place[0] + weather.cell[0], place[1] + weather.cell[1],
                             place[2] + weather.cell[2]);
    const float rough = 0.6F * smooth_noise(at * 4.0F) + 0.4F * smooth_noise(at * 16.0F);
    const float depth = weather.snow_depth_m, deep = 0.35F * std::min(depth / 0.3F, 1.0F);
    const float slope = normal[2] + 0.5F * (rough - 0.5F);
    o.snow = smoothstep(0.55F - deep, 0.85F - deep, slope) * std::clamp(depth / 0.02F - rough, 0.0F, 1.0F);
    for (std::size_t i = 0; i < bands.size(); ++i) {
      reflectance[i] = mix(reflectance[i], kRaySnowReflectance[static_cast<std::size_t>(bands[i])], o.snow);
      transmittance[i] *= 1.0F - o.snow;
    }
    o.roughness = mix(o.roughness, 1.0F, o.snow);
    o.metallic *= 1.0F - o.snow;
    o.retro_reflection *= 1.0F - o.snow;
  }
  return o;
}

}  // namespace rigor::render
