// Light of the sky on surfaces, from a sky map. Internal to sim/render/view.
#pragma once

#include <array>

#include "sim/render/view/view_structs.h"

namespace rigor::render {

/// Irradiance by normal as a polynomial of order 2: e0 + e1 y + e2 z + e3 x + e4 xy + e5 yz + e6 (3z² − 1) +
/// e7 xz + e8 (x² − y²), W/m² (Ramamoorthi and Hanrahan 2001).
using SkyLight = std::array<Spectrum, 9>;

/// Of the upper half of the sky alone. Null: dark.
[[nodiscard]] SkyLight sky_light(const SkyMap* map);
/// With the light that ground of the frame's albedo, lit by sun and sky, sends up from below the horizon.
/// `ground_radiance`: what it sends, W/(m² sr).
[[nodiscard]] SkyLight with_ground(const SkyLight& sky, const Light& light, Spectrum& ground_radiance);
[[nodiscard]] Spectrum irradiance(const SkyLight& light, const Eigen::Vector3d& normal);

}  // namespace rigor::render
