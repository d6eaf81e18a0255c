// Samples that the instants of an exposure share: LightMeter::measure_shared and its parts.
#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <unordered_set>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/one_source.h"
#include "sim/sensors/tof/tof_light.h"

namespace rigor::tof {
namespace {

using Math = models::TofMath<float>;
using render::Hit;
using render::Ray;

std::size_t pixels_of(const SampleRays& rays) {
  return static_cast<std::size_t>(rays.width_px) * static_cast<std::size_t>(rays.height_px);
}
std::size_t samples_each(const SampleRays& rays) { return static_cast<std::size_t>(rays.side * rays.side); }

/// Nodes of what does not stand in the same place in all frames.
std::unordered_set<std::uint64_t> moving_nodes(const render::ContentWindow& window) {
  std::unordered_set<std::uint64_t> nodes;
  const auto& first = window.first().batches;
  if (std::all_of(window.frames.begin(), window.frames.end(),
                  [&](const auto& f) { return f->batches == first; }))
    return nodes;
  std::unordered_map<const render::Batch*, std::size_t> in_frames;
  for (const auto& f : window.frames)
    for (const auto& b : f->batches)
      if (b) ++in_frames[b.get()];
  for (const auto& [b, count] : in_frames) {
    if (count == window.frames.size()) continue;
    if (b->nodes.empty() || b->nodes.size() < b->instances.size()) nodes.insert(b->node.value);
    for (const world::NodeId& n : b->nodes) nodes.insert(n.value);
  }
  return nodes;
}

/// Which cell of which pixel sees a point of the optical frame.
class CellGrid {
 public:
  CellGrid(const models::TofModel& m, int side)
      : l_(m.lens),
        fx_(static_cast<float>(side * m.fx_px)),
        fy_(static_cast<float>(side * m.fy_px)),
        cx_(static_cast<float>(side * (m.cx_px + 0.5))),
        cy_(static_cast<float>(side * (m.cy_px + 0.5))),
        side_(static_cast<std::uint32_t>(side)),
        width_(static_cast<std::uint32_t>(m.width_px)),
        columns_(static_cast<float>(side * m.width_px)),
        rows_(static_cast<float>(side * m.height_px)) {}
  [[nodiscard]] std::uint32_t at(const Eigen::Vector3f& p) const {
    if (!(p.z() > 0)) return SampleLight::kNowhere;
    const auto f = [](double v) { return static_cast<float>(v); };
    float x = 0, y = 0, xx = 0, xy = 0, yx = 0, yy = 0, den = 0;
    models::LensMath<float>::lens_distort_jacobian(p.x() / p.z(), p.y() / p.z(), f(l_.k1), f(l_.k2), f(l_.p1),
                                                   f(l_.p2), f(l_.k3), f(l_.k4), f(l_.k5), f(l_.k6), x, y, xx,
                                                   xy, yx, yy, den);
    // Beyond the fold of the lens no ray comes from there.
    if (!(xx * yy - xy * yx > 0) || !(den > 0)) return SampleLight::kNowhere;
    const float u = fx_ * x + cx_, v = fy_ * y + cy_;
    if (!(u >= 0 && u < columns_ && v >= 0 && v < rows_)) return SampleLight::kNowhere;
    const auto x_cell = static_cast<std::uint32_t>(u), y_cell = static_cast<std::uint32_t>(v);
    const std::uint32_t pixel = y_cell / side_ * width_ + x_cell / side_;
    return (pixel * side_ + y_cell % side_) * side_ + x_cell % side_;
  }

 private:
  OpenCvLens l_;
  float fx_, fy_, cx_, cy_;
  std::uint32_t side_, width_;
  float columns_, rows_;
};

Eigen::Vector3f shift_of(std::span<const Instant> instants, std::size_t k) {
  return (instants[k].T_world_sensor.translation() - instants[0].T_world_sensor.translation()).cast<float>();
}

}  // namespace

Status LightMeter::measure_shared(render::RayEngine& engine, const render::ContentWindow& window,
                                  const SampleRays& rays, std::span<const Instant> instants,
                                  const Ambient& sky, std::span<SampleLight> lights) {
  const std::size_t n = samples_each(rays), shots = std::max(n, instants.size());
  shots_.resize(pixels_of(rays) * shots);
  each(shots_.size(), [&](std::size_t i) {
    const std::size_t p = i / shots, r = i % shots;
    shots_[i] = {static_cast<std::uint32_t>(p * n + r % n), static_cast<std::uint16_t>(r % instants.size()),
                 true};
  });
  if (auto s = cast_shots(engine, rays, instants, 0); !s) return s;
  if (auto s = cast_moving(engine, window, rays, instants); !s) return s;

  const render::ContentFrame& frame = window.first();
  background_.clear();
  if (sky.any) {
    if (auto s = shadows_of_shots(engine, rays, instants, sky); !s) return s;
    background_.resize(shots_.size());
    const std::size_t pixels = pixels_of(rays);
    each(shots_.size(), [&](std::size_t i) {
      const Shot& shot = shots_[i];
      const bool shade = in_shade_[shot.instant * pixels + shot.sample / n] != 0;
      background_[i] = sky.share * background_radiance(hits_[i], vec(rays_[i].direction),
                                                       instants[shot.instant].T_world_sensor.translation(),
                                                       shade, frame, sky);
    });
  }
  for (std::size_t k = 0; k < instants.size(); ++k) {
    lights[k].bounce_e.clear();
    lights[k].bounce_range_m.clear();
    light_of_shots(rays, k, instants, frame, lights[k]);
  }
  return {};
}

/// Those from `first` on.
Status LightMeter::cast_shots(render::RayEngine& engine, const SampleRays& rays,
                              std::span<const Instant> instants, std::size_t first) {
  if (first == shots_.size()) return {};
  rays_.resize(shots_.size());
  hits_.resize(shots_.size());
  for (std::size_t k = 0; k < instants.size(); ++k) {
    const Eigen::Matrix3f R = instants[k].T_world_sensor.linear().cast<float>();
    const Eigen::Vector3f from = shift_of(instants, k);
    each(shots_.size() - first, [&](std::size_t at) {
      const Shot& shot = shots_[first + at];
      if (shot.instant != k) return;
      Ray& ray = rays_[first + at];
      ray = Ray{.time = instants[k].time};
      const std::size_t i = shot.sample;
      for (int a = 0; a < 3; ++a) {
        ray.origin[a] = from[a];
        ray.direction[a] = R(a, 0) * rays.x[i] + R(a, 1) * rays.y[i] + R(a, 2) * rays.z[i];
      }
    });
  }
  return engine.cast(query(instants[0], std::span<const Ray>(rays_).subspan(first), 1e-3F),
                     std::span(hits_).subspan(first));
}

/// Where something moves, the samples that were not cast at each instant.
Status LightMeter::cast_moving(render::RayEngine& engine, const render::ContentWindow& window,
                               const SampleRays& rays, std::span<const Instant> instants) {
  const std::size_t pixels = pixels_of(rays), n = samples_each(rays), shots = shots_.size() / pixels;
  moving_px_.assign(pixels, 0);
  const auto nodes = moving_nodes(window);
  if (nodes.empty()) return {};
  const auto w = static_cast<std::size_t>(rays.width_px), h = static_cast<std::size_t>(rays.height_px);
  for (std::size_t i = 0; i < shots_.size(); ++i) {
    if (hits_[i].nothing() || !nodes.contains(hits_[i].node.value)) continue;
    const std::size_t u = i / shots % w, v = i / shots / w;
    for (std::size_t y = v > 0 ? v - 1 : 0; y <= std::min(v + 1, h - 1); ++y)
      for (std::size_t x = u > 0 ? u - 1 : 0; x <= std::min(u + 1, w - 1); ++x) moving_px_[y * w + x] = 1;
  }
  const std::size_t first = shots_.size();
  for (std::size_t p = 0; p < pixels; ++p) {
    if (moving_px_[p] == 0) continue;
    for (std::size_t r = 0; r < shots; ++r) shots_[p * shots + r].shared = false;
    for (std::size_t k = 0; k < instants.size(); ++k)
      for (std::size_t i = 0; i < n; ++i) {
        bool there = false;
        for (std::size_t r = i; r < shots; r += n) there = there || r % instants.size() == k;
        if (!there)
          shots_.push_back({static_cast<std::uint32_t>(p * n + i), static_cast<std::uint16_t>(k), false});
      }
  }
  return cast_shots(engine, rays, instants, first);
}

/// Of the middle sample: at the one instant of it that comes first, or where something moves at each.
Status LightMeter::shadows_of_shots(render::RayEngine& engine, const SampleRays& rays,
                                    std::span<const Instant> instants, const Ambient& sky) {
  const std::size_t pixels = pixels_of(rays);
  in_shade_.assign(pixels * instants.size(), 0);
  if (!model_.sampling.sun_shadows || sky.sun_irradiance <= 0) return {};
  const Vector sun = vec(sky.sun);
  asked_.clear();
  more_rays_.clear();
  std::vector<std::uint8_t> seen(pixels, 0);
  for (std::size_t i = 0; i < shots_.size(); ++i) {
    const Shot& shot = shots_[i];
    const std::size_t p = shot.sample / samples_each(rays);
    if (shot.sample != rays.middle_sample(p) || (shot.shared && seen[p] != 0)) continue;
    seen[p] = 1;
    const Hit& hit = hits_[i];
    const Vector normal = vec(hit.normal);
    if (hit.nothing() || !(dot(normal, sun) > 0)) continue;
    const Vector start =
        vec(rays_[i].origin) + vec(rays_[i].direction) * hit.range_m + normal * lift_m(hit.range_m);
    Ray ray{.time = rays_[i].time};
    ray.origin[0] = start.x, ray.origin[1] = start.y, ray.origin[2] = start.z;
    std::copy(sky.sun, sky.sun + 3, ray.direction);
    more_rays_.push_back(ray);
    asked_.push_back(static_cast<std::uint32_t>(i));
  }
  hidden_.resize(asked_.size());
  if (auto s = engine.occluded(query(instants[0], more_rays_, 1e-3F), hidden_); !s) return s;
  for (std::size_t a = 0; a < asked_.size(); ++a) {
    const Shot& shot = shots_[asked_[a]];
    const std::size_t p = shot.sample / samples_each(rays);
    for (std::size_t k = 0; k < instants.size(); ++k)
      if (shot.shared || k == shot.instant) in_shade_[k * pixels + p] = hidden_[a];
  }
  return {};
}

void LightMeter::light_of_shots(const SampleRays& rays, std::size_t k, std::span<const Instant> instants,
                                const render::ContentFrame& frame, SampleLight& light) const {
  const std::size_t n = samples_each(rays);
  light.active_e.resize(shots_.size());
  light.range_m.resize(shots_.size());
  light.cell.resize(shots_.size());
  light.ambient_e.resize(background_.size());
  const Air air(frame, band_, instants[k].T_world_sensor.translation().z());
  const bool clear = air.clear();
  const CellGrid grid(model_, rays.side);
  const Eigen::Matrix3f R_sensor_world = instants[k].T_world_sensor.linear().transpose().cast<float>();
  const Eigen::Vector3f eye = shift_of(instants, k);
  std::vector<std::uint8_t> same(instants.size());  // instants whose pose is this one's
  for (std::size_t j = 0; j < instants.size(); ++j)
    same[j] = instants[j].T_world_sensor.matrix() == instants[k].T_world_sensor.matrix() ? 1 : 0;
  each(shots_.size(), [&](std::size_t i) {
    const Shot& shot = shots_[i];
    const Hit& hit = hits_[i];
    light.active_e[i] = light.range_m[i] = 0;
    if (!background_.empty()) light.ambient_e[i] = 0;
    std::uint32_t cell = shot.sample;
    light.cell[i] = SampleLight::kNowhere;
    if (shot.instant != k && !shot.shared) return;
    Eigen::Vector3f d(rays_[i].direction[0], rays_[i].direction[1], rays_[i].direction[2]);
    float range_m = hit.range_m, cosine = hit.cos_incidence;
    if (same[shot.instant] == 0 && d.allFinite()) {
      if (!hit.nothing()) {
        const Eigen::Vector3f from(rays_[i].origin[0], rays_[i].origin[1], rays_[i].origin[2]);
        d = (from - eye) + d * hit.range_m;
        range_m = d.norm();
        if (!(range_m > 1e-3F)) return;
        d /= range_m;
        cosine =
            std::min(1.0F, std::abs(hit.normal[0] * d.x() + hit.normal[1] * d.y() + hit.normal[2] * d.z()));
      }
      cell = grid.at(R_sensor_world * d);
      if (cell == SampleLight::kNowhere) return;
    }
    // A pixel that sees something that moves has all its own.
    if (shot.instant != k && moving_px_[cell / n] != 0) return;
    light.cell[i] = cell;
    if (!background_.empty()) light.ambient_e[i] = electrons(rays.gain[cell] * background_[i]);
    if (hit.nothing()) return;
    Hit seen = hit;
    seen.cos_incidence = cosine;
    float e = Math::tof_active_electrons(rays.gain[cell], rays.intensity_w_per_sr[cell], range_m,
                                         remission(seen, model_.sampling.retro_gain));
    if (!clear) e *= air.transmission(static_cast<double>(range_m), static_cast<double>(d.z()));
    light.active_e[i] = electrons(e);
    light.range_m[i] = range_m;
  });
}

}  // namespace rigor::tof
