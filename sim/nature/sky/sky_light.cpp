#include "sim/nature/sky/sky_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/nature/sky/air.h"
#include "sim/nature/sky/clouds.h"

namespace rigor::nature {
namespace {

using std::numbers::pi;
constexpr double kRadPerDeg = pi / 180;

/// Airglow and starlight, moonless, away from cities: 21.6 mag/arcsec² in V, and the OH bands in the
/// infrared.
constexpr Spectrum kNightRadiance = {4e-7F, 3.5e-7F, 2.5e-7F, 3e-7F, 3e-7F, 6e-6F};
/// Kasten & Czeplak 1980: an overcast sky lets a quarter of the clear sky's light through. Drops absorb at
/// 1550 nm.
constexpr BandValues kOvercastShare = {0.25, 0.25, 0.25, 0.245, 0.24, 0.18};

double smooth_step(double a, double b, double x) {
  const double t = std::clamp((x - a) / (b - a), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}
double overcast_share(double cover) { return smooth_step(0.7, 1.0, cover); }

double elevation_of_row(int row) { return (row + 0.5) * pi / 2 / kSkyHeight; }
double azimuth_of_column(int column) { return (column + 0.5) * 2 * pi / kSkyWidth; }
Spectrum& texel(render::SkyMap& map, int column, int row) {
  return map.radiance[static_cast<std::size_t>(row * kSkyWidth + column)];
}

/// Way from the eye up to a shell, round earth.
double way_to_shell(double elevation_rad, double height_m) {
  const double s = std::sin(elevation_rad), r = kEarthRadius_m;
  return -r * s + std::sqrt(r * r * s * s + 2 * r * height_m + height_m * height_m);
}

/// What a layer of a vertical depth lets through from the sun; at the horizon the layer is as thick as the
/// round earth makes it.
double slant_share(double depth, double sun_elevation_deg) {
  return std::exp(-std::min(depth / std::max(std::sin(sun_elevation_deg * kRadPerDeg), 0.03), 80.0));
}

/// Henyey & Greenstein.
double forward_phase(double c, double g) {
  const double x = 1 + g * g - 2 * g * c;
  return (1 - g * g) / (4 * pi * (x * std::sqrt(x)));
}

/// Cumulus over the clear sky.
void draw_clouds(const ClearSky& clear, const SkyState& s, const BandValues& solar, const Spectrum& above,
                 const Spectrum& albedo, render::SkyMap& map) {
  const CloudField field(s.cloud_cover);
  const double height_m = s.air.height_m + kCloudBase_m;
  const double sun_elevation = s.sun_elevation_deg * kRadPerDeg, sin_sun = std::sin(sun_elevation);
  const Eigen::Vector2d to_sun(std::sin(s.sun_azimuth_deg * kRadPerDeg),
                               std::cos(s.sun_azimuth_deg * kRadPerDeg));
  // Sunlight at the layer: the ground's horizon is lower there, so clouds glow when the sun has set.
  const double lit = sun_above_ground(height_m, sin_sun);
  const auto through = clear.air().transmittance(columns_to_space(height_m, sin_sun));
  const double reach_m =
      std::clamp(250 / std::max(std::tan(std::max(sun_elevation, 0.01)), 0.2), 150.0, 1000.0);
  for (int row = 0; row < kSkyHeight; ++row) {
    const double elevation = elevation_of_row(row);
    const double way = way_to_shell(elevation, kCloudBase_m);
    const double footprint = way * (pi / 2 / kSkyHeight) / std::max(std::sin(elevation), 0.02) * 0.5;
    // Air between cloud and eye, the light of which stands in the clear sky behind it.
    const auto near = clear.air().transmittance(
        {way * (1 - std::exp(-kCloudBase_m / kRayleighScaleHeight_m)) /
             (kCloudBase_m / kRayleighScaleHeight_m),
         way * (1 - std::exp(-kCloudBase_m / kAerosolScaleHeight_m)) / (kCloudBase_m / kAerosolScaleHeight_m),
         0});
    const double ground_way = std::min(way * std::cos(elevation), 200'000.0);
    for (int column = 0; column < kSkyWidth; ++column) {
      const double azimuth = azimuth_of_column(column);
      const Eigen::Vector2d p =
          ground_way * Eigen::Vector2d(std::sin(azimuth), std::cos(azimuth)) - s.cloud_drift_m;
      const double depth = field.optical_depth(p, footprint);
      if (!(depth > 0)) continue;
      const double towards_sun = field.optical_depth(p + reach_m * to_sun, std::max(footprint, 120.0));
      const double open = std::exp(-0.12 * std::max(0.0, towards_sun - 0.3 * depth));
      const double cos_between =
          std::sin(elevation) * sin_sun +
          std::cos(elevation) * std::cos(sun_elevation) * std::cos(azimuth - s.sun_azimuth_deg * kRadPerDeg);
      const double base = cloud_transmittance(depth);
      const double cover = 1 - std::exp(-0.8 * depth);
      const double thin = std::min(depth, 4.0) * std::exp(-0.7 * depth);
      auto& out = texel(map, column, row);
      for (int b = 0; b < kBandCount; ++b) {
        const double sun = solar[b] * through[b] * lit;
        const double radiance =
            sun / pi * (0.75 * base * std::max(sin_sun, 0.0) + 0.30 * open * (0.7 - 0.3 * cos_between)) +
            0.25 * sun * forward_phase(cos_between, 0.8) * thin * open + 0.7 * above[b] / pi * base +
            albedo[b] * (sun * std::max(sin_sun, 0.0) + above[b]) / pi * 0.6 * (1 - base);
        const double seen = near[b];
        out[b] = static_cast<float>(out[b] * (1 - cover * seen) + radiance * cover * seen);
      }
    }
  }
}

/// Puts a scattering layer of a vertical depth under the sky. Sky and sun are dimmed along their ways; the
/// layer itself glows, around the sun where it is thin and evenly where it is thick, so that a level plane
/// gets what two streams leave of all light. `direct_level`: the sun's irradiance on a level plane, above the
/// layer and, when this returns, below it. Returns the radiance of an endless way through the layer: the mean
/// of light from above and, by the ground, from below.
Spectrum put_layer(const Spectrum& depth, const SkyState& s, const Spectrum& albedo, Spectrum& direct_level,
                   render::SkyMap& map) {
  constexpr double kAsymmetry = 0.74;
  const Spectrum from_sky = level_irradiance(map);
  BandValues forward{};  // share of the glow that lies about the sun
  for (int b = 0; b < kBandCount; ++b)
    forward[b] = s.sun_elevation_deg > 0 ? std::exp(-(1 - kAsymmetry) * depth[b]) : 0;
  render::SkyMap glow;
  glow.width = kSkyWidth;
  glow.height = kSkyHeight;
  glow.radiance.resize(map.radiance.size());
  const double sin_sun = std::sin(s.sun_elevation_deg * kRadPerDeg),
               cos_sun = std::cos(s.sun_elevation_deg * kRadPerDeg);
  for (int row = 0; row < kSkyHeight; ++row) {
    const double up = std::sin(elevation_of_row(row)), out = std::cos(elevation_of_row(row));
    Spectrum left{};
    for (int b = 0; b < kBandCount; ++b)
      left[b] = static_cast<float>(std::exp(-std::min(depth[b] / std::max(up, 0.02), 80.0)));
    for (int column = 0; column < kSkyWidth; ++column) {
      const double cos_between =
          up * sin_sun + out * cos_sun * std::cos(azimuth_of_column(column) - s.sun_azimuth_deg * kRadPerDeg);
      const double about_sun = 4 * pi * forward_phase(cos_between, kAsymmetry);
      auto& sky = texel(map, column, row);
      auto& own = texel(glow, column, row);
      for (int b = 0; b < kBandCount; ++b) {
        own[b] = static_cast<float>((1 - left[b]) * (1 - forward[b] + forward[b] * about_sun));
        sky[b] *= left[b];
      }
    }
  }
  const Spectrum straight = level_irradiance(map), pattern = level_irradiance(glow);
  Spectrum strength{}, endless{};
  for (int b = 0; b < kBandCount; ++b) {
    const double all = (direct_level[b] + from_sky[b]) * cloud_transmittance(depth[b]);
    direct_level[b] *= static_cast<float>(slant_share(depth[b], s.sun_elevation_deg));
    const double rest = std::max(0.0, all - direct_level[b] - straight[b]);
    strength[b] = pattern[b] > 1e-6F ? static_cast<float>(rest / pattern[b]) : 0;
    endless[b] = static_cast<float>(all / pi * 0.5 * (1 + albedo[b]));
  }
  for (std::size_t i = 0; i < map.radiance.size(); ++i)
    for (int b = 0; b < kBandCount; ++b) map.radiance[i][b] += strength[b] * glow.radiance[i][b];
  return endless;
}

/// Clouds alone, at the place where the sun shines through them.
double cloud_share(const SkyState& s) {
  if (!(s.cloud_cover > 0)) return 1;
  const double elevation = std::max(s.sun_elevation_deg, 0.5) * kRadPerDeg;
  const double ground_way = std::min(way_to_shell(elevation, kCloudBase_m) * std::cos(elevation), 200'000.0);
  const Eigen::Vector2d p = ground_way * Eigen::Vector2d(std::sin(s.sun_azimuth_deg * kRadPerDeg),
                                                         std::cos(s.sun_azimuth_deg * kRadPerDeg)) -
                            s.cloud_drift_m;
  const double depth = CloudField(s.cloud_cover).optical_depth(p, 60);
  return slant_share(depth, s.sun_elevation_deg) * (1 - overcast_share(s.cloud_cover));
}

bool any(const Spectrum& s) {
  return std::any_of(s.begin(), s.end(), [](float x) { return x > 0; });
}

}  // namespace

Spectrum ground_albedo(double snow_depth_m) {
  constexpr Spectrum kLand = {0.09F, 0.09F, 0.05F, 0.30F, 0.31F, 0.22F};
  constexpr Spectrum kSnow = {0.90F, 0.91F, 0.91F, 0.83F, 0.80F, 0.07F};
  const auto covered = static_cast<float>(1 - std::exp(-std::max(snow_depth_m, 0.0) / 0.04));
  Spectrum s{};
  for (int b = 0; b < kBandCount; ++b) s[b] = kLand[b] * (1 - covered) + kSnow[b] * covered;
  return s;
}

Spectrum extra_haze_depth(const SkyState& s) {
  const auto extinction = haze_extinction_per_m(s.visibility_m);
  const auto have = optical_depths(s.air.turbidity).aerosol;
  Spectrum d{};
  for (int b = 0; b < kBandCount; ++b)
    d[b] = static_cast<float>(std::max(0.0, extinction[b] * kHazeDepth_m - have[b]));
  return d;
}

Spectrum fog_depth(const SkyState& s) {
  auto d = haze_extinction_per_m(s.fog_visibility_m);
  for (auto& x : d) x *= static_cast<float>(std::max(s.fog_depth_m, 0.0));
  return d;
}

Spectrum sun_share(const SkyState& s) {
  const auto haze = extra_haze_depth(s), fog = fog_depth(s);
  const double clouds = cloud_share(s);
  Spectrum share{};
  for (int b = 0; b < kBandCount; ++b)
    share[b] = static_cast<float>(clouds * slant_share(haze[b] + fog[b], s.sun_elevation_deg));
  return share;
}

Spectrum sun_irradiance(const SkyState& s) {
  Spectrum e = direct_irradiance(s.sun_elevation_deg, s.sun_distance_au, s.air);
  const auto share = sun_share(s);
  for (int b = 0; b < kBandCount; ++b) e[b] *= share[b];
  return e;
}

Spectrum level_irradiance(const render::SkyMap& map) {
  BandValues sum{};
  for (int row = 0; row < map.height; ++row) {
    const double e0 = row * pi / 2 / map.height, e1 = (row + 1) * pi / 2 / map.height;
    const double weight = pi * (std::sin(e1) * std::sin(e1) - std::sin(e0) * std::sin(e0)) / map.width;
    for (int column = 0; column < map.width; ++column)
      for (int b = 0; b < kBandCount; ++b)
        sum[b] += weight * map.radiance[static_cast<std::size_t>(row * map.width + column)][b];
  }
  Spectrum s{};
  for (int b = 0; b < kBandCount; ++b) s[b] = static_cast<float>(sum[b]);
  return s;
}

SkyLight make_sky_light(const ClearSky& clear, const SkyState& s) {
  auto made = std::make_shared<render::SkyMap>();
  render::SkyMap& map = *made;
  map.width = kSkyWidth;
  map.height = kSkyHeight;
  map.radiance.resize(static_cast<std::size_t>(kSkyWidth * kSkyHeight));
  // Water vapour lies low: light of the sky has come through about as much of it as the sun's, but by ways
  // above the horizon when the sun is below.
  const auto water = water_vapour_transmittance(precipitable_water_cm(s.air.temperature_c),
                                                std::min(low_air_mass(s.sun_elevation_deg), 10.0));
  BandValues solar{};
  for (int b = 0; b < kBandCount; ++b)
    solar[b] = kSolarIrradiance[b] * water[b] / (s.sun_distance_au * s.sun_distance_au);
  if (s.sun_elevation_deg > -19) {
    const auto view = clear.view(s.sun_elevation_deg, s.air.height_m, solar, kSkyHeight);
    for (int row = 0; row < kSkyHeight; ++row)
      for (int column = 0; column < kSkyWidth; ++column)
        texel(map, column, row) =
            view.radiance(row, azimuth_of_column(column) - s.sun_azimuth_deg * kRadPerDeg);
  }
  for (auto& t : map.radiance)
    for (int b = 0; b < kBandCount; ++b) t[b] += kNightRadiance[b];

  const auto albedo = ground_albedo(s.snow_depth_m);
  const double sin_sun = std::max(std::sin(s.sun_elevation_deg * kRadPerDeg), 0.0);
  Spectrum direct_level = direct_irradiance(s.sun_elevation_deg, s.sun_distance_au, s.air);
  for (auto& x : direct_level) x *= static_cast<float>(sin_sun);
  if (s.cloud_cover > 0) {
    const Spectrum above = level_irradiance(map);
    const double even = overcast_share(s.cloud_cover), share = cloud_share(s);
    if (even < 1) draw_clouds(clear, s, solar, above, albedo, map);
    for (int row = 0; row < kSkyHeight && even > 0; ++row) {
      // CIE standard overcast sky: (1 + 2 sin e)/3 of the zenith, whose radiance is 9/(7 pi) of the level
      // irradiance.
      const double pattern = 9 / (7 * pi) * (1 + 2 * std::sin(elevation_of_row(row))) / 3;
      for (int column = 0; column < kSkyWidth; ++column)
        for (int b = 0; b < kBandCount; ++b) {
          auto& out = texel(map, column, row)[b];
          const double overcast = pattern * kOvercastShare[b] * (direct_level[b] + above[b]);
          out = static_cast<float>(out * (1 - even) + overcast * even);
        }
    }
    for (auto& x : direct_level) x *= static_cast<float>(share);
  }

  SkyLight light;
  constexpr int kHorizonRows = 3;
  for (int b = 0; b < kBandCount; ++b) {
    double sum = 0;
    for (int row = 0; row < kHorizonRows; ++row)
      for (int column = 0; column < kSkyWidth; ++column) sum += texel(map, column, row)[b];
    light.haze_radiance[b] = static_cast<float>(sum / (kHorizonRows * kSkyWidth));
  }
  if (const auto depth = extra_haze_depth(s); any(depth)) put_layer(depth, s, albedo, direct_level, map);
  light.fog_radiance = light.haze_radiance;
  if (const auto depth = fog_depth(s); any(depth))
    light.fog_radiance = put_layer(depth, s, albedo, direct_level, map);
  light.map = std::move(made);
  return light;
}

}  // namespace rigor::nature
