// Light and air of a frame, as shading (shading.h) asks for them: where the shaders of the view estimate what
// hides the sky and the sun, rays find it. Internal to sim/render/rays.
//
// Places are relative to an origin that the caller chooses, world axes, metres; radiance W/(m² sr),
// irradiance W/m². Everything const: any thread.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "sim/render/content/content.h"
#include "sim/render/rays/light_sky.h"
#include "sim/render/rays/shading.h"

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

/// Wet and snowed upon, at a place with this normal.
void weather(const LightFrame& frame, Vec3 place, Vec3 normal, MaterialSample& s) noexcept;

/// Of a surface that mirrors nothing: none.
[[nodiscard]] Mirror mirror_of(const MaterialSample& s, Vec3 view, Vec3 n) noexcept;
[[nodiscard]] inline bool any(const Mirror& m) noexcept { return largest(m.share) > 0; }
/// What the mirror shows of surroundings that nothing hides. `irradiance`: theirs on a plane whose normal is
/// the mirror's direction.
[[nodiscard]] Bands4 mirrored_sky(const LightFrame& frame, const Mirror& m, Bands4 irradiance) noexcept;

}  // namespace rigor::render::light
