#include "sim/sensors/tof/tof_light.h"

#include <algorithm>
#include <cmath>

#include "sensor-hal/models/lidar/lidar_math.h"
#include "sim/sensors/tof/tof_effects.h"
#include "sim/sensors/tof/tof_light_math.h"
#include "sim/world/semantic_types.h"

namespace rigor::tof {
namespace {

using Math = models::TofMath<float>;
using render::Hit;
using render::Ray;

/// Irradiance of the sky on a level plane.
double level_irradiance(const render::SkyMap& sky, std::size_t band) {
  double sum = 0;
  const double cell =
      2 * std::numbers::pi / std::max(sky.width, 1) * (std::numbers::pi / 2) / std::max(sky.height, 1);
  for (int j = 0; j < sky.height; ++j) {
    const double elevation = (j + 0.5) / sky.height * std::numbers::pi / 2;
    for (int i = 0; i < sky.width; ++i)
      sum += static_cast<double>(sky.radiance[static_cast<std::size_t>(j * sky.width + i)][band]) *
             std::sin(elevation) * std::cos(elevation) * cell;
  }
  return sum;
}

}  // namespace

int nearest_band(double wavelength_m) {
  int best = 0;
  for (int b = 1; b < render::kBandCount; ++b)
    if (std::abs(world::kBandWavelength_nm[static_cast<std::size_t>(b)] - wavelength_m * 1e9) <
        std::abs(world::kBandWavelength_nm[static_cast<std::size_t>(best)] - wavelength_m * 1e9))
      best = b;
  return best;
}

float remission(const Hit& hit, double retro_gain) {
  return models::LidarMath<float>::lidar_surface_remission(hit.cos_incidence, hit.reflectance, hit.metallic,
                                                           hit.roughness, hit.retro_reflection,
                                                           static_cast<float>(retro_gain));
}

double band_width_m(int band) { return band < 3 ? 100e-9 : 50e-9; }

LightMeter::LightMeter(const models::TofModel& model, models::PhiloxKey key)
    : model_(model), key_(key), band_(nearest_band(model.illumination.wavelength_m)) {}

render::RayQuery LightMeter::query(const Instant& instant, std::span<const Ray> rays, float near_m) const {
  return {.origin = instant.T_world_sensor.translation(), .band = band_, .near_m = near_m, .rays = rays};
}

Status LightMeter::cast(render::RayEngine& engine, const SampleRays& rays,
                        std::span<const Instant> instants) {
  instants_ = instants.size();
  samples_ = rays.count();
  rays_.resize(samples_ * instants_);
  hits_.resize(samples_ * instants_);
  for (std::size_t k = 0; k < instants_; ++k) {
    const Eigen::Matrix3f R = instants[k].T_world_sensor.linear().cast<float>();
    const Eigen::Vector3f from =
        (instants[k].T_world_sensor.translation() - instants[0].T_world_sensor.translation()).cast<float>();
    each(rays.count(), [&](std::size_t i) {
      Ray& ray = rays_[at(i, k)];
      for (int a = 0; a < 3; ++a) {
        ray.origin[a] = from[a];
        ray.direction[a] = R(a, 0) * rays.x[i] + R(a, 1) * rays.y[i] + R(a, 2) * rays.z[i];
      }
      ray.time = instants[k].time;
    });
  }
  return engine.cast(query(instants[0], rays_, 1e-3F), hits_);
}

Result<std::span<const Hit>> LightMeter::cast(render::RayEngine& engine, const SampleRays& rays,
                                              const Instant& instant) {
  if (auto s = cast(engine, rays, std::span(&instant, 1)); !s) return tl::unexpected<Error>(s.error());
  return std::span<const Hit>(hits_);
}

Status LightMeter::measure(render::RayEngine& engine, const render::ContentWindow& window,
                           const CameraRays& camera, std::span<const Instant> instants,
                           std::span<SampleLight> lights) {
  if (instants.size() > 1 && !engine.own_origins()) {
    for (std::size_t k = 0; k < instants.size(); ++k)
      if (auto s = measure(engine, window, camera, instants.subspan(k, 1), lights.subspan(k, 1)); !s)
        return s;
    return {};
  }
  const SampleRays& rays = camera.samples;
  // Light and air change slowly: those of the window's begin.
  const render::ContentFrame& frame = window.first();
  const bool has_filter = model_.optics.filter_width_m > 0;
  const Ambient sky = has_filter ? ambient(frame, rays) : Ambient{};
  if (!rays.lattice && model_.sampling.multipath_rays == 0)
    return measure_shots(engine, window, camera, instants, sky, lights);
  if (auto s = cast(engine, rays, instants); !s) return s;
  if (sky.any)
    if (auto s = shadows(engine, rays, instants, sky); !s) return s;
  for (std::size_t k = 0; k < instants.size(); ++k) {
    SampleLight& light = lights[k];
    light.parts = {};
    active(rays, k, instants[k], frame, light);
    light.ambient_e.clear();
    if (sky.any) background(rays, k, instants[k], frame, sky, light);
    light.bounce_e.clear();
    light.bounce_range_m.clear();
    if (model_.sampling.multipath_rays > 0)
      if (auto s = bounce(engine, rays, k, instants[k], light); !s) return s;
  }
  return {};
}

void LightMeter::active(const SampleRays& rays, std::size_t k, const Instant& instant,
                        const render::ContentFrame& frame, SampleLight& light) const {
  light.active_e.resize(rays.count());
  light.range_m.resize(rays.count());
  const Air air(frame, band_, instant.T_world_sensor.translation().z());
  const bool clear = air.clear();
  each(rays.count(), [&](std::size_t i) {
    const Hit& h = hits_[at(i, k)];
    if (h.nothing()) {
      light.active_e[i] = light.range_m[i] = 0;
      return;
    }
    float e = Math::tof_active_electrons(rays.gain[i], rays.intensity_w_per_sr[i], h.range_m,
                                         remission(h, model_.sampling.retro_gain));
    if (!clear)
      e *=
          air.transmission(static_cast<double>(h.range_m), static_cast<double>(rays_[at(i, k)].direction[2]));
    light.active_e[i] = electrons(e);
    light.range_m[i] = h.range_m;
  });
}

LightMeter::Ambient LightMeter::ambient(const render::ContentFrame& frame, const SampleRays& rays) {
  Ambient a;
  const auto b = static_cast<std::size_t>(band_);
  const render::Light& light = frame.light;
  a.share = static_cast<float>(std::min(1.0, model_.optics.filter_width_m / band_width_m(band_)));
  const Eigen::Vector3f sun = light.direction_to_sun.cast<float>();
  for (int i = 0; i < 3; ++i) a.sun[i] = sun[i];
  if (sun.z() > -2 * light.sun_angular_radius_rad) a.sun_irradiance = light.sun_irradiance[b];
  if (light.sky) {
    if (light.sky->serial != sky_serial_) {
      sky_up_ = level_irradiance(*light.sky, b);
      sky_serial_ = light.sky->serial;
    }
    a.sky_irradiance = static_cast<float>(sky_up_);
  }
  a.ground_radiance =
      light.ground_albedo[b] * (a.sky_irradiance + a.sun_irradiance * std::max(0.0F, sun.z())) / kPi;
  if (a.sun_irradiance > 0) {
    // A disc smaller than the way between samples is spread to that, its light kept: it is never missed. Of
    // jittered samples it holds a whole cell, wherever it is.
    const float spacing =
        static_cast<float>(1 / std::min(model_.fx_px, model_.fy_px)) / static_cast<float>(rays.side);
    const bool jittered = rays.side > 1 && !rays.lattice;
    const float radius = std::max(light.sun_angular_radius_rad, (jittered ? 1.42F : 0.75F) * spacing);
    a.sun_cos = std::cos(radius);
    a.sun_beside_cos = std::cos(radius + 2 * spacing * static_cast<float>(rays.side));
    a.sun_disc_radiance = a.sun_irradiance / (kPi * radius * radius);
  }
  a.any = a.sun_irradiance > 0 || a.sky_irradiance > 0;
  for (const render::PointLight& lamp : frame.lamps) a.any = a.any || lamp.radiant_intensity[b] > 0;
  return a;
}

Status LightMeter::shadows(render::RayEngine& engine, const SampleRays& rays,
                           std::span<const Instant> instants, const Ambient& sky) {
  const std::size_t pixels =
      static_cast<std::size_t>(rays.width_px) * static_cast<std::size_t>(rays.height_px);
  in_shade_.assign(pixels * instants.size(), 0);
  if (!model_.sampling.sun_shadows || sky.sun_irradiance <= 0) return {};
  const Vector sun = vec(sky.sun);
  // What a pixel sees stays the same place while it is the same thing within this of the range.
  constexpr float kSamePlace = 0.01F;
  asked_.clear();
  more_rays_.clear();
  for (std::size_t k = 0; k < instants.size(); ++k)
    for (std::size_t p = 0; p < pixels; ++p) {
      const std::size_t s = rays.middle_sample(p);
      const Hit& h = hits_[at(s, k)];
      const Vector n = vec(h.normal);
      if (h.nothing() || !(dot(n, sun) > 0)) continue;
      if (k > 0) {
        const Hit& before = hits_[at(s, 0)];
        const Vector n0 = vec(before.normal);
        if (!before.nothing() && before.node.value == h.node.value && dot(n0, sun) > 0 &&
            std::abs(before.range_m - h.range_m) < kSamePlace * h.range_m)
          continue;  // below
      }
      const Ray& seen = rays_[at(s, k)];
      const Vector start = vec(seen.origin) + vec(seen.direction) * h.range_m + n * lift_m(h.range_m);
      Ray ray{.time = instants[k].time};
      ray.origin[0] = start.x, ray.origin[1] = start.y, ray.origin[2] = start.z;
      std::copy(sky.sun, sky.sun + 3, ray.direction);
      more_rays_.push_back(ray);
      asked_.push_back(static_cast<std::uint32_t>(k * pixels + p));
    }
  hidden_.resize(asked_.size());
  if (auto s = engine.occluded(query(instants[0], more_rays_, 1e-3F), hidden_); !s) return s;
  std::size_t next = 0;
  for (std::size_t i = 0; i < in_shade_.size(); ++i) {
    const bool fresh = next < asked_.size() && asked_[next] == i;
    in_shade_[i] = fresh ? hidden_[next++] : i >= pixels ? in_shade_[i % pixels] : 0;
  }
  return {};
}

float LightMeter::background_radiance(const Hit& h, Vector d, const Eigen::Vector3d& eye, bool in_shade,
                                      const render::ContentFrame& frame, const Ambient& sky) const {
  const auto b = static_cast<std::size_t>(band_);
  const Vector sun = vec(sky.sun);
  if (h.nothing()) {
    const float radiance = d.z >= 0 && frame.light.sky
                               ? frame.light.sky->at(Eigen::Vector3f(d.x, d.y, d.z).cast<double>())[b]
                               : sky.ground_radiance;
    return dot(d, sun) > sky.sun_cos ? radiance + sky.sun_disc_radiance : radiance;
  }
  const Vector n = vec(h.normal);
  const float cos_sun = dot(n, sun);
  // An even sky over an even ground (Liu & Jordan 1963).
  const float up = 0.5F * (1 + n.z), down = 1 - up;
  float front = sky.sky_irradiance * up + kPi * sky.ground_radiance * down;
  float back = sky.sky_irradiance * down + kPi * sky.ground_radiance * up;
  front += (in_shade ? 0.0F : sky.sun_irradiance) * std::max(cos_sun, 0.0F);
  back += sky.sun_irradiance * std::max(-cos_sun, 0.0F);
  for (const render::PointLight& lamp : frame.lamps) {
    const Eigen::Vector3f to =
        (lamp.position - eye).cast<float>() - Eigen::Vector3f(d.x, d.y, d.z) * h.range_m;
    const float d2 = std::max(to.squaredNorm(), 1e-4F);
    const float c = dot(n, {to.x(), to.y(), to.z()}) / std::sqrt(d2);
    (c > 0 ? front : back) += lamp.radiant_intensity[b] / d2 * std::abs(c);
  }
  return (h.reflectance * front + h.transmittance * back) / kPi;
}

void LightMeter::background(const SampleRays& rays, std::size_t k, const Instant& instant,
                            const render::ContentFrame& frame, const Ambient& sky, SampleLight& light) const {
  light.ambient_e.resize(rays.count());
  const std::uint8_t* const in_shade =
      &in_shade_[k * static_cast<std::size_t>(rays.width_px) * static_cast<std::size_t>(rays.height_px)];
  each(rays.count(), [&](std::size_t i) {
    light.ambient_e[i] = rays.gain[i] > 0
                             ? electrons(rays.gain[i] * sky.share *
                                         background_radiance(hits_[at(i, k)], vec(rays_[at(i, k)].direction),
                                                             instant.T_world_sensor.translation(),
                                                             in_shade[rays.pixel_of(i)] != 0, frame, sky))
                             : 0;
  });
}

Status LightMeter::bounce(render::RayEngine& engine, const SampleRays& rays, std::size_t k,
                          const Instant& instant, SampleLight& light) {
  const std::size_t pixels =
      static_cast<std::size_t>(rays.width_px) * static_cast<std::size_t>(rays.height_px);
  const auto each_px = static_cast<std::size_t>(model_.sampling.multipath_rays);
  const std::size_t count = pixels * each_px;
  more_rays_.resize(count);
  more_hits_.resize(count);
  hidden_.resize(count);
  light.bounce_e.resize(count);
  light.bounce_range_m.resize(count);
  // From the first surface into its hemisphere, as Lambert's cosine weighs it.
  each(count, [&](std::size_t i) {
    const std::size_t s = rays.middle_sample(i / each_px);
    const Hit& h = hits_[at(s, k)];
    Ray& ray = more_rays_[i];
    ray = Ray{.time = instant.time};
    if (h.nothing()) {
      ray.direction[0] = std::numeric_limits<float>::quiet_NaN();
      return;
    }
    const auto words =
        models::draw_words(key_, models::NoiseEffect::tof_multipath, 0, static_cast<std::uint32_t>(i));
    const float u = Math::unit_from_bits(words[0]), v = Math::unit_from_bits(words[1]);
    // A stratum of the radius for each ray of the pixel.
    const float r2 = (static_cast<float>(i % each_px) + u) / static_cast<float>(each_px);
    float sin_a = 0, cos_a = 1;
    Math::tof_sincos_turns(v, sin_a, cos_a);
    const Vector n = vec(h.normal), d = vec(rays_[at(s, k)].direction);
    // Axes across the normal (Duff et al., JCGT 6, 2017).
    const float sign = std::copysign(1.0F, n.z), a = -1 / (sign + n.z), b = n.x * n.y * a;
    const Vector t{1 + sign * n.x * n.x * a, sign * b, -sign * n.x}, q{b, sign + n.y * n.y * a, -n.y};
    const float r = std::sqrt(r2);
    const Vector w = t * (r * cos_a) + q * (r * sin_a) + n * std::sqrt(std::max(0.0F, 1 - r2));
    const Vector start = d * h.range_m + n * lift_m(h.range_m);
    ray.origin[0] = start.x, ray.origin[1] = start.y, ray.origin[2] = start.z;
    ray.direction[0] = w.x, ray.direction[1] = w.y, ray.direction[2] = w.z;
  });
  if (auto cast = engine.cast(query(instant, more_rays_, 1e-3F), more_hits_); !cast) return cast;
  // Does the illumination reach the second surface? E and way for those that it does.
  each(count, [&](std::size_t i) {
    const std::size_t s = rays.middle_sample(i / each_px);
    const Hit& second = more_hits_[i];
    Ray& ray = more_rays_[i];
    light.bounce_e[i] = light.bounce_range_m[i] = 0;
    const bool nothing = second.nothing();
    const Vector w = vec(ray.direction);
    const Vector at = vec(ray.origin) + w * (nothing ? 0.0F : second.range_m);
    const Vector n = vec(second.normal);
    ray.direction[0] = std::numeric_limits<float>::quiet_NaN();
    if (nothing) return;
    const float away = std::sqrt(dot(at, at));
    if (!(away > 1e-3F)) return;
    const Vector from = at * (1 / away);
    const float cosine = -dot(n, from);
    if (cosine <= 0) return;
    const Eigen::Vector3f axis = instant.T_world_sensor.linear().col(2).cast<float>();
    const float off_axis = dot(from, {axis.x(), axis.y(), axis.z()});
    if (off_axis <= 0) return;
    const float intensity = static_cast<float>(model_.illumination.radiant_intensity_w_per_sr) *
                            (model_.illumination.cosine_exponent > 0
                                 ? std::pow(off_axis, static_cast<float>(model_.illumination.cosine_exponent))
                                 : 1.0F);
    const Hit& first = hits_[this->at(s, k)];
    // Radiance I cos rho2/(pi R2^2) of the second surface, on average over the cosine-weighted hemisphere,
    // times the first one's reflectance.
    const float e = rays.gain[s] * intensity * cosine * second.reflectance * (1 - second.metallic) *
                    first.reflectance * (1 - first.metallic) / (kPi * away * away) /
                    static_cast<float>(each_px);
    if (!(e > 0 && e < std::numeric_limits<float>::infinity())) return;
    light.bounce_e[i] = e;
    light.bounce_range_m[i] = 0.5F * (first.range_m + second.range_m + away);
    ray.origin[0] = ray.origin[1] = ray.origin[2] = 0;
    ray.direction[0] = from.x, ray.direction[1] = from.y, ray.direction[2] = from.z;
    ray.far_m = away * (1 - 1e-4F) - 1e-3F;
  });
  if (auto s = engine.occluded(query(instant, more_rays_, 1e-3F), hidden_); !s) return s;
  each(count, [&](std::size_t i) {
    if (hidden_[i] != 0) light.bounce_e[i] = 0;
  });
  return {};
}

}  // namespace rigor::tof
