#include "sim/render/rays/light_shading.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace rigor::render::light {
namespace {

/// Reflectance of settled snow, as the view engine has it (Warren 1982, Wiscombe and Warren 1980).
constexpr Spectrum kSnowReflectance{0.92F, 0.93F, 0.94F, 0.87F, 0.83F, 0.12F};
constexpr double kNoisePeriod_m = 1024;
/// Half width of the cone in which a retro-reflector sends light back: of beaded sheeting, about half a
/// degree.
constexpr float kRetroCone_rad = 0.0087F;

/// e^-x for x ≥ 0 within 3e-7 of it; 0 beyond 87.
Bands4 exp_minus(Bands4 x) noexcept {
  using Words = std::int32_t __attribute__((vector_size(16)));
  const Bands4 t = min(x, all_bands(87.0F)) * -std::numbers::log2e_v<float>;
  const Words whole = __builtin_convertvector(t - 0.5F, Words);  // towards 0: t is not positive
  const Bands4 f = (t - __builtin_convertvector(whole, Bands4)) * std::numbers::ln2_v<float>;
  Bands4 p = all_bands(1.0F / 720);
  p = p * f + 1.0F / 120;
  p = p * f + 1.0F / 24;
  p = p * f + 1.0F / 6;
  p = p * f + 0.5F;
  p = p * f + 1.0F;
  p = p * f + 1.0F;
  const Words scale = (whole + 127) << 23;
  Bands4 s;
  std::memcpy(&s, &scale, sizeof s);
  return x < 87.0F ? p * s : Bands4{};
}

std::uint32_t pcg(std::uint32_t v) noexcept {
  const std::uint32_t state = v * 747796405U + 2891336453U;
  const std::uint32_t word = ((state >> ((state >> 28U) + 4U)) ^ state) * 277803737U;
  return (word >> 22U) ^ word;
}
float corner(int x, int y, int z) noexcept {
  const auto c = [](int v) { return static_cast<std::uint32_t>(v) & 1023U; };
  return static_cast<float>(pcg(c(x) + 1024U * c(y) + 1048576U * c(z)) >> 8U) / 16777216.0F;
}
/// As noise.glsl: cells of 1 m, period 1024 m.
float smooth_noise(Vec3 p) noexcept {
  const Vec3 base{std::floor(p.x), std::floor(p.y), std::floor(p.z)};
  const auto eased = [](float f) { return f * f * (3.0F - 2.0F * f); };
  const float fx = eased(p.x - base.x), fy = eased(p.y - base.y), fz = eased(p.z - base.z);
  const int x = static_cast<int>(base.x), y = static_cast<int>(base.y), z = static_cast<int>(base.z);
  const Bands4 low{corner(x, y, z), corner(x + 1, y, z), corner(x, y + 1, z), corner(x + 1, y + 1, z)};
  const Bands4 high{corner(x, y, z + 1), corner(x + 1, y, z + 1), corner(x, y + 1, z + 1),
                    corner(x + 1, y + 1, z + 1)};
  const Bands4 at = mix(low, high, fz);
  return mix(mix(at[0], at[1], fx), mix(at[2], at[3], fx), fy);
}

/// GGX with Schlick's Fresnel term; the height-correlated visibility as 1 / (4 l.h^2) (Lazarov 2011).
Bands4 highlight(Vec3 n, Vec3 view, Vec3 light, float roughness, Bands4 f0) noexcept {
  const float alpha = std::max(roughness * roughness, 0.0025F);
  const Vec3 h = unit(view + light, n);
  const float nh = std::max(dot(n, h), 0.0F), lh = std::max(dot(light, h), 0.05F);
  const float f = nh * nh * (alpha * alpha - 1.0F) + 1.0F;
  const float grazing = std::max(1.0F - lh, 0.0F), grazing2 = grazing * grazing;
  const Bands4 fresnel = f0 + (1.0F - f0) * (grazing2 * grazing2 * grazing);
  return fresnel * (alpha * alpha / (kPi * f * f) / (4.0F * lh * lh));
}

Bands4 at_right_angles(const MaterialSample& s) noexcept {
  return s.water ? all_bands(0.02F) : mix(all_bands(0.04F), s.reflectance, s.metallic);
}

Bands4 diffuse(const MaterialSample& s) noexcept {
  return s.glossy ? s.reflectance * (1.0F - s.metallic) : s.reflectance;
}

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
    // Angle from the difference of unit vectors: the cosine has no precision near 1.
    const float apart = length(d - to_sun);
    if (apart < 1.1F * (sun_radius_rad + soft)) {
      const float from_sun = 2.0F * std::asin(std::min(0.5F * apart, 1.0F));
      light += sun_disc * std::clamp((sun_radius_rad - from_sun) / (2 * soft) + 0.5F, 0.0F, 1.0F);
    }
  }
  return light;
}

Bands4 LightFrame::through_air(Bands4 radiance, float a_z, float b_z, float way_m) const noexcept {
  if (air.empty()) return radiance;
  const float low = std::min(a_z, b_z), high = std::max(a_z, b_z);
  Bands4 depth{}, source{};
  for (const AirLayer& l : air) {
    const float share = high - low > 1e-6F ? std::clamp((l.top_m - low) / (high - low), 0.0F, 1.0F)
                                           : (l.top_m > low ? 1.0F : 0.0F);
    const Bands4 tau = l.extinction_per_m * (way_m * share);
    depth += tau;
    source += tau * l.inscatter;
  }
  const Bands4 t = exp_minus(depth);
  return radiance * t + source / max(depth, all_bands(1e-30F)) * (1.0F - t);
}

void weather(const LightFrame& frame, Vec3 place, Vec3 n, MaterialSample& s) noexcept {
  if (frame.wetness > 0) {
    const float wet = frame.wetness;
    s.reflectance *= 1.0F - 0.55F * wet * s.porosity;
    s.roughness = mix(s.roughness, 0.15F,
                      wet * (0.35F + 0.65F * std::clamp(n.z, 0.0F, 1.0F)) * (1.0F - 0.5F * s.porosity));
    if (!s.water) s.glossy = true;
  }
  if (frame.snow_depth_m > 0 && s.takes_snow) {
    const Vec3 at = place + frame.noise_place;
    const float rough = 0.6F * smooth_noise(at * 4.0F) + 0.4F * smooth_noise(at * 16.0F);
    const float deep = std::min(frame.snow_depth_m / 0.3F, 1.0F);
    // Deep snow holds on steeper slopes; a thin layer leaves gaps.
    const float slope = n.z + 0.5F * (rough - 0.5F);
    const float lies = smoothstep(0.55F - 0.35F * deep, 0.85F - 0.35F * deep, slope);
    const float snow = lies * std::clamp(frame.snow_depth_m / 0.02F - rough, 0.0F, 1.0F);
    s.reflectance = mix(s.reflectance, frame.snow, snow);
    s.transmittance *= 1.0F - snow;
    s.roughness = mix(s.roughness, 1.0F, snow);
    s.metallic *= 1.0F - snow;
  }
}

bool may_see_sun(const LightFrame& frame, const MaterialSample& s, Vec3 n, Vec3 n_flat) noexcept {
  if (!frame.sun) return false;
  const float c = dot(n, frame.to_sun);
  return c * dot(n_flat, frame.to_sun) > 0 && (s.translucent || c > 0);
}

Bands4 from_sun(const LightFrame& frame, const MaterialSample& s, Vec3 view, Vec3 n) noexcept {
  const float c = dot(n, frame.to_sun);
  if (c <= 0) return s.translucent ? s.transmittance * frame.sun_irradiance * (-c / kPi) : Bands4{};
  Bands4 light = diffuse(s) / kPi;
  if (s.glossy || s.water) light += highlight(n, view, frame.to_sun, s.roughness, at_right_angles(s));
  return light * frame.sun_irradiance * c;
}

Bands4 from_lamp(const Lamp& lamp, Vec3 to, const MaterialSample& s, Vec3 view, Vec3 n) noexcept {
  const float d2 = std::max(dot(to, to), 1e-4F);
  const Vec3 l = to * (1.0F / std::sqrt(d2));
  const Bands4 e = lamp.intensity / d2;
  const float c = dot(n, l);
  if (c <= 0) return s.translucent ? s.transmittance * e * (-c / kPi) : Bands4{};
  Bands4 light = diffuse(s) / kPi;
  if (s.glossy) light += highlight(n, view, l, s.roughness, mix(all_bands(0.04F), s.reflectance, s.metallic));
  if (s.retro_reflection > 0) {
    // A share of what falls on it, in a narrow cone about where it comes from. Less the cosine: what is sent
    // back leaves through as small an area as it came.
    const Vec3 apart = view - l;
    const float width2 = kRetroCone_rad * kRetroCone_rad;
    light += s.retro_reflection / (kPi * width2 * std::max(c, 0.05F)) * std::exp(-dot(apart, apart) / width2);
  }
  return light * e * c;
}

Bands4 from_sky(const MaterialSample& s, Bands4 irradiance, Bands4 irradiance_behind) noexcept {
  Bands4 light = diffuse(s) * irradiance;
  if (s.translucent) light += s.transmittance * irradiance_behind;
  return light / kPi;
}

Mirror mirror(const MaterialSample& s, Vec3 view, Vec3 n) noexcept {
  Mirror m;
  if (!s.glossy && !s.water) return m;
  const float c = dot(n, view);
  const Bands4 f0 = at_right_angles(s);
  // The sky's mirror image, the blurrier the rougher; the mean over the lobe of a rough one is weak.
  const float grazing = 1.0F - std::clamp(c, 0.0F, 1.0F), grazing2 = grazing * grazing;
  const Bands4 fresnel = f0 + (max(all_bands(1.0F - s.roughness), f0) - f0) * (grazing2 * grazing2 * grazing);
  const float keep = s.water ? 1.0F : 1.0F - s.roughness;
  m.direction = n * (2.0F * c) - view;
  if (s.water) m.direction.z = std::abs(m.direction.z);
  m.share = fresnel * (s.water ? 1.0F : mix(keep, 1.0F, s.metallic));
  m.sharp = keep * keep;
  return m;
}

Bands4 mirrored_sky(const LightFrame& frame, const Mirror& m, Bands4 irradiance) noexcept {
  const Bands4 blurred = irradiance / kPi;
  if (!(m.sharp > 0)) return blurred;
  const float above = smoothstep(-0.1F, 0.05F, m.direction.z);
  const Bands4 sharp = above > 0 ? mix(frame.ground, frame.sky->radiance(m.direction), above) : frame.ground;
  return mix(blurred, sharp, m.sharp);
}

}  // namespace rigor::render::light
