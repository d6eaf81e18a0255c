// Surfaces as rays ask for them: which maps they have, what stands at a place on their texture, and what
// weather makes of it (shading.h). Maps are looked up bilinearly in their finest level. Internal to
// sim/render/rays.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "sim/render/content/content.h"
#include "sim/render/rays/leaf_cover.h"

namespace rigor::render {

/// The alpha of its colour map cuts holes into it.
[[nodiscard]] bool has_holes(const Surface& surface) noexcept;

struct RaySurface {
  /// `surface` null: a matt grey named `unknown`. `holes`: null where has_holes() says no.
  RaySurface(std::shared_ptr<const Surface> surface, std::shared_ptr<const LeafCover> holes);
  std::shared_ptr<const Surface> surface;  ///< never null
  const Texture *colour = nullptr, *near_infrared = nullptr, *normal = nullptr, *gloss = nullptr;
  std::shared_ptr<const LeafCover> holes;
  bool translucent = false;
};

/// Weather on surfaces, and where the pattern of snow stands.
struct RayWeather {
  float wetness = 0, snow_depth_m = 0;
  float cell[3]{};  ///< the scene's cell modulo 1024 m
};

/// What a surface is at a point, besides its reflectance by band.
struct PointOptics {
  float roughness = 1, metallic = 0, retro_reflection = 0, snow = 0;
  bool water = false;
};

/// The normal map's direction at (u, v): x along growing u, y towards the picture's top, z off the surface.
[[nodiscard]] Eigen::Vector3f mapped_normal(const RaySurface& s, float u, float v) noexcept;

/// Reflectance and transmittance of each of `bands` (index of world::kBandWavelength_nm) with maps, tint,
/// wetness and snow. `normal`: with the normal map, world axes; `place`: relative to the scene's cell.
PointOptics optics_at(const RaySurface& s, const float uv[2], const float tint[3], const float normal[3],
                      const float place[3], const RayWeather& weather, std::span<const int> bands,
                      float* reflectance, float* transmittance) noexcept;

}  // namespace rigor::render
