#include "sim/render/rays/light_shading.h"

#include <algorithm>
#include <cmath>

namespace rigor::render::light {
namespace {

constexpr double kNoisePeriod_m = 1024;

Bands4 finite_only(Bands4 v) noexcept {
  for (int b = 0; b < 4; ++b) v[b] = std::isfinite(v[b]) && v[b] > 0 ? v[b] : 0.0F;
  return v;
}

}  // namespace

LightFrame light_frame(const ContentFrame& frame, const Eigen::Vector3d& origin,
                       const std::array<int, 4>& bands, std::shared_ptr<const SkyTables> sky) {
  LightFrame out;
  const Light& light = frame.light;
  Eigen::Vector3d to_sun = light.direction_to_sun;
  const bool valid = to_sun.allFinite() && to_sun.norm() > 1e-9;
  if (valid) to_sun.normalize();
  out.sun_irradiance = finite_only(pick(light.sun_irradiance, bands));
  out.sun = valid && to_sun.z() > 0 && largest(out.sun_irradiance) > 0;
  const auto place = [](const Eigen::Vector3d& v) {
    return Vec3{static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
  };
  if (out.sun)
    out.to_sun = place(to_sun);
  else
    out.sun_irradiance = Bands4{};
  const float radius = light.sun_angular_radius_rad;
  out.sun_radius_rad = std::isfinite(radius) ? std::clamp(radius, 1e-4F, 0.5F) : 1e-4F;
  out.sun_disc = out.sun_irradiance / (kPi * out.sun_radius_rad * out.sun_radius_rad);
  out.sky = std::move(sky);
  const Bands4 down = out.sky->irradiance({0, 0, 1});
  out.ground = finite_only(pick(light.ground_albedo, bands)) / kPi *
               (down + std::max(out.to_sun.z, 0.0F) * out.sun_irradiance);
  out.snow = pick(kSnowReflectance, bands);
  const auto bounded = [](float v, float high) { return v > 0 ? std::min(v, high) : 0.0F; };
  out.wetness = bounded(frame.surface.wetness, 1);
  out.snow_depth_m = bounded(frame.surface.snow_depth_m, 1e3F);
  const auto wrapped = [](double v) {
    return std::isfinite(v) ? v - std::floor(v / kNoisePeriod_m) * kNoisePeriod_m : 0.0;
  };
  out.noise_place = place({wrapped(origin.x()), wrapped(origin.y()), wrapped(origin.z())});

  const auto add_air = [&](Bands4 extinction, Bands4 inscatter, double top_m) {
    extinction = finite_only(extinction);
    if (!(largest(extinction) > 0)) return;
    const double top = std::isnan(top_m) ? 1e9 : std::clamp(top_m - origin.z(), -1e9, 1e9);
    out.air.push_back({extinction, finite_only(inscatter), static_cast<float>(top)});
  };
  for (const Haze& h : frame.hazes)
    add_air(pick(h.extinction_per_m, bands), pick(h.inscattered_radiance, bands), h.top_m);
  if (frame.precipitation.kind != Precipitation::Kind::none)
    add_air(pick(frame.precipitation.extinction_per_m, bands),
            (out.irradiance({0, 0, 1}) + out.irradiance({0, 0, -1})) / (2 * kPi),
            std::numeric_limits<double>::infinity());
  for (const PointLight& l : frame.lamps) {
    const Bands4 intensity = finite_only(pick(l.radiant_intensity, bands));
    if (l.position.allFinite() && largest(intensity) > 0)
      out.lamps.push_back({place(l.position - origin), intensity});
  }
  return out;
}

Bands4 LightFrame::irradiance(Vec3 n) const noexcept {
  // A half sphere of one radiance: pi (1 - n.z) / 2 of it.
  return sky->irradiance(n) + ground * (0.5F * kPi * (1.0F - n.z));
}

Bands4 LightFrame::nothing_met(Vec3 d, float spread_rad) const noexcept {
  const float soft = 0.5F * std::max(spread_rad, 1e-6F);
  Bands4 light;
  if (d.z >= soft)
    light = sky->radiance(d);
  else if (d.z <= -soft)
    light = ground;
  else
    light = mix(ground, sky->radiance(d), smoothstep(-soft, soft, d.z));
  if (sun && d.z >= 0) {
    // Saves most rays the arc sine.
    if (length(d - to_sun) < 1.1F * (sun_radius_rad + soft))
      light += sun_disc * disc_share(d, to_sun, sun_radius_rad, 2 * soft);
  }
  return light;
}

Bands4 LightFrame::through_air(Bands4 radiance, float a_z, float b_z, float way_m) const noexcept {
  if (air.empty()) return radiance;
  Bands4 depth{}, source{};
  for (const AirLayer& l : air) {
    const Bands4 tau = l.extinction_per_m * (way_m * share_below(l.top_m, a_z, b_z));
    depth += tau;
    source += tau * l.inscatter;
  }
  return behind_air(radiance, depth, source);
}

void weather(const LightFrame& frame, Vec3 place, Vec3 n, MaterialSample& s) noexcept {
  if (frame.wetness > 0) s = wet(s, frame.wetness, n.z);
  if (frame.snow_depth_m > 0 && s.takes_snow > 0)
    s = snowy(s, frame.snow, s.takes_snow * snow_cover(place + frame.noise_place, n.z, frame.snow_depth_m));
}

Mirror mirror_of(const MaterialSample& s, Vec3 view, Vec3 n) noexcept {
  return s.glossy || s.water ? mirror(s, view, n) : Mirror{};
}

Bands4 mirrored_sky(const LightFrame& frame, const Mirror& m, Bands4 irradiance) noexcept {
  const Bands4 blurred = irradiance / kPi;
  if (!(m.sharp > 0)) return blurred;
  const float above = sky_in_mirror(m.direction);
  const Bands4 sharp = above > 0 ? mix(frame.ground, frame.sky->radiance(m.direction), above) : frame.ground;
  return mix(blurred, sharp, m.sharp);
}

}  // namespace rigor::render::light
