// From what a surface is at a point to the light that leaves it towards an eye, and what the air on the way
// does to it: the arithmetic of shaders/view/light.glsl and surface_light.glsl, four bands at a time. Where
// the shaders estimate what hides the sky and the sun, these take it as an argument. Internal to
// sim/render/rays.
//
// Places are relative to an origin that the caller chooses, world axes, metres; radiance W/(m² sr),
// irradiance W/m². Everything const: any thread.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "sim/render/content/content.h"
#include "sim/render/rays/light_sky.h"
#include "sim/render/rays/light_vec.h"

namespace rigor::render::light {

struct AirLayer {
  Bands4 extinction_per_m, inscatter;
  float top_m;  ///< above the origin
};
struct Lamp {
  Vec3 place;
  Bands4 intensity;
};

/// Light and air of a frame.
struct LightFrame {
  bool sun = false;
  Vec3 to_sun{0, 0, -1};
  float sun_radius_rad = 0;
  Bands4 sun_irradiance{}, sun_disc{};  ///< on a plane square to it; its radiance
  std::shared_ptr<const SkyTables> sky;
  Bands4 ground{};  ///< radiance of what lies below the horizon
  float wetness = 0, snow_depth_m = 0;
  Bands4 snow{};     ///< reflectance of lying snow
  Vec3 noise_place;  ///< of the origin, modulo the noise's period
  std::vector<AirLayer> air;
  std::vector<Lamp> lamps;

  /// W/m² of open sky and ground on a plane of this normal.
  [[nodiscard]] Bands4 irradiance(Vec3 n) const noexcept;
  /// Of sky or ground, without the sun.
  [[nodiscard]] Bands4 surroundings(Vec3 d) const noexcept { return d.z >= 0 ? sky->radiance(d) : ground; }
  /// What a ray brings that meets nothing: sky, ground, the sun's disc. `spread_rad`: between neighbouring
  /// rays; edges are as soft as that. Without air.
  [[nodiscard]] Bands4 nothing_met(Vec3 d, float spread_rad) const noexcept;
  /// Radiance after the way from b to a through the air. `way_m`: its length.
  [[nodiscard]] Bands4 through_air(Bands4 radiance, float a_z_m, float b_z_m, float way_m) const noexcept;
};

/// `sky`: of the frame's sky map in the same bands.
[[nodiscard]] LightFrame light_frame(const ContentFrame& frame, const Eigen::Vector3d& origin,
                                     const std::array<int, 4>& bands, std::shared_ptr<const SkyTables> sky);

/// A surface at a point: maps and tint are in it.
struct MaterialSample {
  Bands4 reflectance{}, transmittance{};
  float roughness = 1, metallic = 0, porosity = 0.5F, retro_reflection = 0;
  bool translucent = false, glossy = false, water = false, takes_snow = false;
};

/// Wet and snowed upon, at a place with this normal.
void weather(const LightFrame& frame, Vec3 place, Vec3 normal, MaterialSample& s) noexcept;

/// False where no sun can come to a point from, whatever stands between: a face turned away from it is dark
/// whatever its bumps say; a leaf may be lit through.
[[nodiscard]] bool may_see_sun(const LightFrame& frame, const MaterialSample& s, Vec3 n,
                               Vec3 n_flat) noexcept;

/// Light of the sun that leaves towards `view` (unit length) where all of it is seen.
[[nodiscard]] Bands4 from_sun(const LightFrame& frame, const MaterialSample& s, Vec3 view, Vec3 n) noexcept;
/// As above, of a lamp at a way `to` from the point.
[[nodiscard]] Bands4 from_lamp(const Lamp& lamp, Vec3 to, const MaterialSample& s, Vec3 view,
                               Vec3 n) noexcept;
/// What is diffusely scattered of the irradiances of both sides.
[[nodiscard]] Bands4 from_sky(const MaterialSample& s, Bands4 irradiance, Bands4 irradiance_behind) noexcept;

/// The mirror image of the surroundings: Fresnel's share of it, and how sharp it is.
struct Mirror {
  Vec3 direction;
  Bands4 share{};
  float sharp = 0;  ///< 0: the mean over the side of the mirrored direction … 1: what lies in it
  [[nodiscard]] bool any() const noexcept { return largest(share) > 0; }
};
[[nodiscard]] Mirror mirror(const MaterialSample& s, Vec3 view, Vec3 n) noexcept;
/// What the mirror shows of surroundings that nothing hides. `irradiance`: theirs on a plane whose normal is
/// the mirror's direction.
[[nodiscard]] Bands4 mirrored_sky(const LightFrame& frame, const Mirror& m, Bands4 irradiance) noexcept;

}  // namespace rigor::render::light
