// Sun, sky and haze of one moment: what weather makes of the clear sky.
//
// Layers, from above: clear sky, clouds (cumulus that thicken to an even overcast), the part of the haze that
// the turbidity does not hold already, fog. Each dims the sun's direct light and sends part of it on as light
// from the sky. All pure functions: the same state gives the same bytes.
#pragma once

#include <memory>

#include "sim/nature/sky/sky_scattering.h"

namespace rigor::nature {

inline constexpr int kSkyWidth = 1024, kSkyHeight = 256;
/// Haze of a meteorological range fills this much air above the eye; a fog without a top, this much.
inline constexpr double kHazeDepth_m = kAerosolScaleHeight_m, kEndlessFogDepth_m = 300;

struct SkyState {
  double sun_azimuth_deg = 180, sun_elevation_deg = 45, sun_distance_au = 1;
  ClearAir air{};
  double cloud_cover = 0;
  Eigen::Vector2d cloud_drift_m = Eigen::Vector2d::Zero();  ///< of the field since time 0
  double visibility_m = std::numeric_limits<double>::infinity();
  double fog_visibility_m = std::numeric_limits<double>::infinity();
  double fog_depth_m = 0;  ///< above the eye
  double snow_depth_m = 0;
};

/// Of the land at large: forest and meadow, whitened by lying snow.
[[nodiscard]] Spectrum ground_albedo(double snow_depth_m);

struct SkyLight {
  std::shared_ptr<const render::SkyMap> map;
  Spectrum haze_radiance{}, fog_radiance{};  ///< of an endless way through them
};

/// Vertical optical depths of haze (beyond what turbidity accounts for) and fog over the eye.
[[nodiscard]] Spectrum extra_haze_depth(const SkyState& s);
[[nodiscard]] Spectrum fog_depth(const SkyState& s);
/// Share of the sun's direct light that clouds, haze and fog let through.
[[nodiscard]] Spectrum sun_share(const SkyState& s);
/// Direct irradiance on a plane square to the sun, under clouds, haze and fog, W/m².
[[nodiscard]] Spectrum sun_irradiance(const SkyState& s);

/// About 30 ms. `clear`: of the state's turbidity and ground albedo.
[[nodiscard]] SkyLight make_sky_light(const ClearSky& clear, const SkyState& s);

/// Irradiance on a level plane from a map, W/m².
[[nodiscard]] Spectrum level_irradiance(const render::SkyMap& map);

}  // namespace rigor::nature
