#include "sim/render/view/sky_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::render {
namespace {

using std::numbers::pi;
// Real spherical harmonics times the convolution with the clamped cosine: pi, 2 pi / 3, pi / 4.
constexpr double kY0 = 0.28209479177387814, kY1 = 0.4886025119029199, kY2 = 1.0925484305920792,
                 kY20 = 0.31539156525252005, kY22 = 0.5462742152960396;
constexpr std::array<double, 9> kNorm{kY0, kY1, kY1, kY1, kY2, kY2, kY20, kY2, kY22};
constexpr std::array<double, 9> kConvolved{pi,     2 * pi / 3, 2 * pi / 3, 2 * pi / 3, pi / 4,
                                           pi / 4, pi / 4,     pi / 4,     pi / 4};

std::array<double, 9> basis(const Eigen::Vector3d& d) {
  const double x = d.x(), y = d.y(), z = d.z();
  return {1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y};
}

}  // namespace

SkyLight sky_light(const SkyMap* map) {
  std::array<std::array<double, kBandCount>, 9> sum{};
  SkyLight out{};
  if (map == nullptr || map->width < 1 || map->height < 1) return out;
  for (int j = 0; j < map->height; ++j) {
    const double low = j * 0.5 * pi / map->height, high = (j + 1) * 0.5 * pi / map->height;
    // Four directions a texel: a coarse map's texels are wide.
    for (int sub = 0; sub < 4; ++sub) {
      const double elevation = low + (sub + 0.5) / 4 * (high - low);
      const double part =
          (std::sin(low + (sub + 1) * (high - low) / 4) - std::sin(low + sub * (high - low) / 4)) * 2 * pi /
          map->width;
      for (int i = 0; i < map->width; ++i) {
        const double azimuth = (i + 0.5) * 2 * pi / map->width;
        const Eigen::Vector3d d(std::sin(azimuth) * std::cos(elevation),
                                std::cos(azimuth) * std::cos(elevation), std::sin(elevation));
        const auto b = basis(d);
        const Spectrum& l = map->radiance[static_cast<std::size_t>(j * map->width + i)];
        for (std::size_t k = 0; k < 9; ++k)
          for (std::size_t band = 0; band < l.size(); ++band)
            sum[k][band] += part * b[k] * kNorm[k] * l[band];
      }
    }
  }
  for (std::size_t k = 0; k < 9; ++k)
    for (std::size_t band = 0; band < out[k].size(); ++band)
      out[k][band] = static_cast<float>(sum[k][band] * kNorm[k] * kConvolved[k]);
  return out;
}

Spectrum irradiance(const SkyLight& light, const Eigen::Vector3d& normal) {
  const auto b = basis(normal);
  Spectrum e{};
  for (std::size_t band = 0; band < e.size(); ++band) {
    double sum = 0;
    for (std::size_t k = 0; k < 9; ++k) sum += b[k] * static_cast<double>(light[k][band]);
    e[band] = static_cast<float>(std::max(sum, 0.0));
  }
  return e;
}

SkyLight with_ground(const SkyLight& sky, const Light& light, Spectrum& ground_radiance) {
  SkyLight out = sky;
  const Spectrum down = irradiance(sky, Eigen::Vector3d::UnitZ());
  const double sun = std::max(light.direction_to_sun.normalized().z(), 0.0);
  for (std::size_t band = 0; band < ground_radiance.size(); ++band) {
    const double radiance =
        light.ground_albedo[band] / pi *
        (static_cast<double>(down[band]) + sun * static_cast<double>(light.sun_irradiance[band]));
    ground_radiance[band] = static_cast<float>(radiance);
    // A half sphere of one radiance: pi (1 ∓ n.z) / 2 of it.
    out[0][band] += static_cast<float>(0.5 * pi * radiance);
    out[2][band] -= static_cast<float>(0.5 * pi * radiance);
  }
  return out;
}

}  // namespace rigor::render
