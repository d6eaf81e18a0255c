// Rays where they are needed, shared between the instants of an exposure: LightMeter::measure_shots and its
// parts.
#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/one_source.h"
#include "sim/sensors/tof/tof_light.h"

namespace rigor::tof {
namespace {

using Math = models::TofMath<float>;
using render::Hit;
using render::Ray;

/// What lies off the plane of its neighbours by this share of its range, reflects so much more or less, or
/// has a normal that is turned by more than this cosine says, wants all samples of a pixel.
constexpr float kOffPlane = 0.001F, kOther = 0.1F, kSameNormal = 0.99F;
/// Ranges of samples of a pixel that differ by more than this share, and not along the surface, are those of
/// different things.
constexpr float kApart = 0.01F;
/// A pixel that is covered less than this by what was met at other instants is measured anew; less strict
/// where none about it sends back what it can measure.
constexpr float kLeastCover = 0.95F, kLeastDarkCover = 0.5F;
/// From a sample to the middle of its pixel a plane's range changes by less than this share, unless it is
/// seen edge-on.
constexpr float kMostMoved = 0.2F;
/// Rays that follow each other look at a square of so many pixels.
constexpr int kTile_px = 4;

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

/// At which what is shared is cast.
std::size_t shared_instant(std::size_t instants) { return instants / 2; }

Eigen::Vector3f vec3(const float* v) { return {v[0], v[1], v[2]}; }
Eigen::Vector3f point_of(const Ray& ray, const Hit& hit) {
  return vec3(ray.origin) + hit.range_m * vec3(ray.direction);
}
/// Do two rays of a pixel meet different things?
bool apart(const Ray& a_ray, const Hit& a, const Ray& b_ray, const Hit& b) {
  if (a.nothing() || b.nothing()) return a.nothing() != b.nothing();
  if (std::abs(a.range_m - b.range_m) <= kApart * a.range_m) return false;
  return !(std::abs(vec3(a.normal).dot(point_of(b_ray, b) - point_of(a_ray, a))) <= kApart * a.range_m);
}
Eigen::Vector3f shift_of(std::span<const Instant> instants, std::size_t k) {
  return (instants[k].T_world_sensor.translation() - instants[0].T_world_sensor.translation()).cast<float>();
}

}  // namespace

Status LightMeter::measure_shots(render::RayEngine& engine, const render::ContentWindow& window,
                                 const CameraRays& rays, std::span<const Instant> instants,
                                 const Ambient& sky, std::span<SampleLight> lights) {
  aim_first(rays.samples, instants.size());
  if (auto s = cast_shots(engine, rays.samples, instants, 0); !s) return s;
  find_plain(rays.samples, sky);
  const std::size_t pixels = shots_.size();
  if (auto s = cast_others(engine, rays.samples, instants); !s) return s;
  if (auto s = cast_moving(engine, window, rays.samples, instants); !s) return s;
  move_to_middles(rays, instants);
  if (sky.any)
    if (auto s = shadows_of_shots(engine, instants, sky, 0); !s) return s;

  const render::ContentFrame& frame = window.first();
  scratch_.resize(instants.size());
  const auto light = [&](std::size_t from) {
    const bool move = instants.size() > 1;
    background_.resize(sky.any ? shots_.size() : 0);
    returns_.resize(move ? shots_.size() : 0);
    each(shots_.size() - from, [&](std::size_t at) {
      const std::size_t i = from + at;
      if (sky.any) background_of_shot(i, instants, frame, sky);
      if (move) returns_.set(i, rays_[i], hits_[i], model_.sampling.retro_gain);
    });
    tbb::parallel_for(std::size_t{0}, instants.size(),
                      [&](std::size_t k) { light_of_shots(rays, k, instants, frame, lights[k], from); });
  };
  for (SampleLight& l : lights) {
    l.bounce_e.clear();
    l.bounce_range_m.clear();
    l.parts.clear(pixels);
  }
  light(0);
  if (instants.size() == 1) return {};
  const std::size_t shared = shots_.size();
  aim_at_holes(rays.samples, lights);
  if (auto s = cast_shots(engine, rays.samples, instants, shared); !s) return s;
  if (sky.any)
    if (auto s = shadows_of_shots(engine, instants, sky, shared); !s) return s;
  light(shared);
  return {};
}

/// One sample of each pixel, at the instant in the middle.
void LightMeter::aim_first(const SampleRays& rays, std::size_t instants) {
  shots_.clear();
  shot_of_px_.resize(rays.pixels());
  const int w = rays.width_px, h = rays.height_px;
  for (int v0 = 0; v0 < h; v0 += kTile_px)
    for (int u0 = 0; u0 < w; u0 += kTile_px)
      for (int v = v0; v < std::min(v0 + kTile_px, h); ++v)
        for (int u = u0; u < std::min(u0 + kTile_px, w); ++u) {
          const auto p = static_cast<std::uint32_t>(v * w + u);
          const std::uint32_t draw =
              rays.side == 1 ? 0 : models::draw_words(key_, models::NoiseEffect::tof_jitter, 1, p)[0];
          shot_of_px_[p] = static_cast<std::uint32_t>(shots_.size());
          shots_.push_back({p, static_cast<std::uint16_t>(draw % rays.each()),
                            static_cast<std::uint16_t>(shared_instant(instants))});
        }
}

/// Those from `first` on.
Status LightMeter::cast_shots(render::RayEngine& engine, const SampleRays& rays,
                              std::span<const Instant> instants, std::size_t first) {
  if (first == shots_.size()) return {};
  rays_.resize(shots_.size());
  hits_.resize(shots_.size());
  struct Pose {
    Eigen::Matrix3f R;
    Eigen::Vector3f from;
  };
  std::vector<Pose> poses;
  for (std::size_t k = 0; k < instants.size(); ++k)
    poses.push_back({instants[k].T_world_sensor.linear().cast<float>(), shift_of(instants, k)});
  const std::size_t n = rays.each();
  each(shots_.size() - first, [&](std::size_t at) {
    const Shot& shot = shots_[first + at];
    Ray& ray = rays_[first + at];
    ray = Ray{.time = instants[shot.instant].time};
    const std::size_t i = shot.pixel * n + shot.sample;
    const auto& [R, from] = poses[shot.instant];
    for (int a = 0; a < 3; ++a) {
      ray.origin[a] = from[a];
      ray.direction[a] = R(a, 0) * rays.x[i] + R(a, 1) * rays.y[i] + R(a, 2) * rays.z[i];
    }
  });
  return engine.cast(query(instants[0], std::span<const Ray>(rays_).subspan(first), 1e-3F),
                     std::span(hits_).subspan(first));
}

/// What a shot met sends back less than half of what a pixel can measure.
bool LightMeter::dark(std::size_t shot, const SampleRays& rays) const {
  const Hit& hit = hits_[shot];
  const std::size_t sample = shots_[shot].pixel * rays.each() + shots_[shot].sample;
  return hit.nothing() ||
         Math::tof_active_electrons(rays.gain[sample], rays.intensity_w_per_sr[sample], hit.range_m,
                                    remission(hit, model_.sampling.retro_gain)) <
             static_cast<float>(model_.limits.min_amplitude_e / model_.modulation.contrast);
}

/// Where one sample says what all of them would, it stands for the whole pixel. That is so where it and those
/// of all neighbours lie in a plane of even remission and normals, or where none of them sends back half of
/// what the pixel can measure.
void LightMeter::find_plain(const SampleRays& rays, const Ambient& sky) {
  plane_.assign(shot_of_px_.size(), Eigen::Vector3f::Zero());
  dark_px_.assign(shot_of_px_.size(), 0);
  const int w = rays.width_px, h = rays.height_px;
  each(shots_.size(), [&](std::size_t i) {
    Shot& shot = shots_[i];
    const int u = static_cast<int>(shot.pixel) % w, v = static_cast<int>(shot.pixel) / w;
    shot.whole = rays.side == 1;
    if (u == 0 || v == 0 || u == w - 1 || v == h - 1) return;
    std::uint32_t at[9];
    for (int k = 0; k < 9; ++k)
      at[k] = shot_of_px_[static_cast<std::size_t>((v + k / 3 - 1) * w + u + k % 3 - 1)];
    const bool all_dark = std::all_of(at, at + 9, [&](std::uint32_t q) { return dark(q, rays); });
    // The sun's disc may be smaller than a pixel.
    const bool by_the_sun = dot(vec(rays_[i].direction), vec(sky.sun)) > sky.sun_beside_cos;
    dark_px_[shot.pixel] = all_dark && !by_the_sun;
    shot.whole = shot.whole || dark_px_[shot.pixel] != 0;
    const Hit& mine = hits_[i];
    if (shot.whole || mine.nothing()) return;
    const auto alike = [](float a, float b) { return std::abs(a - b) <= kOther * b; };
    const float remission_of_mine = remission(mine, model_.sampling.retro_gain);
    Eigen::Vector3f points[9];
    for (int k = 0; k < 9; ++k) {
      const Hit& hit = hits_[at[k]];
      if (hit.nothing() || !alike(remission(hit, model_.sampling.retro_gain), remission_of_mine) ||
          !alike(hit.reflectance, mine.reflectance) ||
          !(dot(vec(hit.normal), vec(mine.normal)) > kSameNormal))
        return;
      points[k] = point_of(rays_[at[k]], hit);
    }
    const Eigen::Vector3f across = (points[5] - points[3]).cross(points[7] - points[1]).normalized();
    if (!across.allFinite()) return;
    for (const Eigen::Vector3f& p : points)
      if (!(std::abs(across.dot(p - points[4])) <= kOffPlane * mine.range_m)) return;
    shot.whole = true;
    plane_[shot.pixel] = across;
  });
}

/// All samples of pixels that are not plain. Where they meet different things, so may those of the pixels
/// around: a thin thing is followed along its way.
Status LightMeter::cast_others(render::RayEngine& engine, const SampleRays& rays,
                               std::span<const Instant> instants) {
  const std::size_t n = rays.each();
  more_of_px_.assign(rays.pixels(), 0);
  if (n == 1) return {};
  std::vector<std::uint32_t> open;
  for (std::size_t i = 0; i < rays.pixels(); ++i)
    if (!shots_[i].whole) open.push_back(shots_[i].pixel);
  const int w = rays.width_px, h = rays.height_px;
  while (!open.empty()) {
    const std::size_t first = shots_.size();
    for (const std::uint32_t p : open) {
      more_of_px_[p] = static_cast<std::uint32_t>(shots_.size());
      const Shot s = shots_[shot_of_px_[p]];
      for (std::size_t r = 1; r < n; ++r)
        shots_.push_back({p, static_cast<std::uint16_t>((s.sample + r) % n), s.instant});
    }
    if (auto s = cast_shots(engine, rays, instants, first); !s) return s;
    const std::vector<std::uint32_t> looked_at = std::exchange(open, {});
    for (const std::uint32_t p : looked_at) {
      const std::size_t one = shot_of_px_[p];
      bool mixed = false;
      for (std::size_t i = more_of_px_[p]; i < more_of_px_[p] + n - 1; ++i)
        mixed = mixed ||
                ((!dark(one, rays) || !dark(i, rays)) && apart(rays_[one], hits_[one], rays_[i], hits_[i]));
      if (!mixed) continue;
      const int u = static_cast<int>(p) % w, v = static_cast<int>(p) / w;
      for (int y = std::max(v - 1, 0); y <= std::min(v + 1, h - 1); ++y)
        for (int x = std::max(u - 1, 0); x <= std::min(u + 1, w - 1); ++x)
          if (Shot& s = shots_[shot_of_px_[static_cast<std::size_t>(y * w + x)]]; s.whole) {
            s.whole = false;
            open.push_back(s.pixel);
          }
    }
  }
  return {};
}

/// Pixels that see something that moves, and those beside them, get all samples at each instant. Where those
/// meet something that moves again, so do the pixels around.
Status LightMeter::cast_moving(render::RayEngine& engine, const render::ContentWindow& window,
                               const SampleRays& rays, std::span<const Instant> instants) {
  moving_px_.assign(rays.pixels(), 0);
  const auto nodes = moving_nodes(window);
  if (nodes.empty() || instants.size() == 1) return {};
  const std::size_t n = rays.each();
  const auto w = static_cast<std::size_t>(rays.width_px), h = static_cast<std::size_t>(rays.height_px);
  std::vector<std::uint32_t> found;
  const auto look_at = [&](const Hit& hit, std::uint32_t pixel) {
    if (hit.nothing() || !nodes.contains(hit.node.value)) return;
    const std::size_t u = pixel % w, v = pixel / w;
    for (std::size_t y = v > 0 ? v - 1 : 0; y <= std::min(v + 1, h - 1); ++y)
      for (std::size_t x = u > 0 ? u - 1 : 0; x <= std::min(u + 1, w - 1); ++x)
        if (std::exchange(moving_px_[y * w + x], 1) == 0)
          found.push_back(static_cast<std::uint32_t>(y * w + x));
  };
  for (std::size_t i = 0; i < shots_.size(); ++i) look_at(hits_[i], shots_[i].pixel);
  // What is elsewhere at the other instants: one ray for each of the other pixels, at one of them.
  const std::size_t pixels = rays.pixels(), all = shots_.size();
  for (std::size_t i = 0; i < pixels; ++i) {
    const Shot s = shots_[i];
    const std::size_t turn = s.pixel % w % 2 + s.pixel / w % 2 * 2;
    const auto instant = static_cast<std::uint16_t>(turn * (instants.size() - 1) / 3);
    if (moving_px_[s.pixel] == 0 && instant != s.instant) shots_.push_back({s.pixel, s.sample, instant});
  }
  if (auto s = cast_shots(engine, rays, instants, all); !s) return s;
  for (std::size_t i = all; i < shots_.size(); ++i) look_at(hits_[i], shots_[i].pixel);
  shots_.resize(all);

  while (!found.empty()) {
    const std::size_t first = shots_.size();
    for (const std::uint32_t p : found) {
      const auto own = static_cast<std::uint16_t>(shots_[shot_of_px_[p]].instant);
      const bool alone = shots_[shot_of_px_[p]].whole;
      shots_[shot_of_px_[p]].whole = shots_[shot_of_px_[p]].shared = false;
      for (std::size_t r = 1; r < n; ++r) {
        if (!alone) {
          shots_[more_of_px_[p] + r - 1].shared = false;
          continue;
        }
        shots_.push_back(
            {p, static_cast<std::uint16_t>((shots_[shot_of_px_[p]].sample + r) % n), own, false});
      }
      for (std::size_t k = 0; k < instants.size(); ++k)
        for (std::size_t r = 0; r < n && k != own; ++r)
          shots_.push_back({p, static_cast<std::uint16_t>(r), static_cast<std::uint16_t>(k), false});
    }
    found.clear();
    if (auto s = cast_shots(engine, rays, instants, first); !s) return s;
    for (std::size_t i = first; i < shots_.size(); ++i) look_at(hits_[i], shots_[i].pixel);
  }
  return {};
}

/// What stands for a whole pixel of a plane is what the ray through the middle of the pixel meets there.
void LightMeter::move_to_middles(const CameraRays& rays, std::span<const Instant> instants) {
  if (rays.samples.side == 1) return;
  each(rays.samples.pixels(), [&](std::size_t i) {
    const Shot& shot = shots_[i];
    const std::size_t p = shot.pixel;
    if (!shot.whole || plane_[p].isZero()) return;
    const Eigen::Vector3f middle = instants[shot.instant].T_world_sensor.linear().cast<float>() *
                                   Eigen::Vector3f(rays.middles.x[p], rays.middles.y[p], rays.middles.z[p]);
    Hit& hit = hits_[i];
    const float range_m = hit.range_m * plane_[p].dot(vec3(rays_[i].direction)) / plane_[p].dot(middle);
    // Not where the plane is seen edge-on, nor beyond the lens.
    if (!(std::abs(range_m - hit.range_m) <= kMostMoved * hit.range_m)) {
      plane_[p].setZero();
      return;
    }
    hit.range_m = range_m;
    hit.cos_incidence = std::clamp(-vec3(hit.normal).dot(middle), 0.0F, 1.0F);
    for (int a = 0; a < 3; ++a) rays_[i].direction[a] = middle[a];
  });
}

/// Of each pixel's first sample, as far as that is among the shots from `first` on: at each instant that it
/// is cast at.
Status LightMeter::shadows_of_shots(render::RayEngine& engine, std::span<const Instant> instants,
                                    const Ambient& sky, std::size_t first) {
  const std::size_t pixels = shot_of_px_.size();
  if (first == 0) in_shade_.assign(pixels * instants.size(), 0);
  for (std::size_t i = first; i < shots_.size() && first > 0; ++i)
    in_shade_[shots_[i].instant * pixels + shots_[i].pixel] = 0;
  if (!model_.sampling.sun_shadows || sky.sun_irradiance <= 0) return {};
  const Vector sun = vec(sky.sun);
  asked_.clear();
  more_rays_.clear();
  for (std::size_t i = first; i < shots_.size(); ++i) {
    const Shot& shot = shots_[i];
    if (shot.sample != shots_[shot_of_px_[shot.pixel]].sample) continue;
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
    for (std::size_t k = 0; k < instants.size(); ++k)
      if (shot.shared || k == shot.instant) in_shade_[k * pixels + shot.pixel] = hidden_[a];
  }
  return {};
}

void LightMeter::background_of_shot(std::size_t i, std::span<const Instant> instants,
                                    const render::ContentFrame& frame, const Ambient& sky) {
  const Shot& shot = shots_[i];
  const bool shade = in_shade_[shot.instant * shot_of_px_.size() + shot.pixel] != 0;
  background_[i] =
      sky.share * background_radiance(hits_[i], vec(rays_[i].direction),
                                      instants[shot.instant].T_world_sensor.translation(), shade, frame, sky);
}

/// What a shot stands for at its own instant.
PicturePart LightMeter::part_of(const Shot& shot, const SampleRays& rays) const {
  const auto w = static_cast<std::uint32_t>(rays.width_px), side = static_cast<std::uint32_t>(rays.side);
  PicturePart part{static_cast<float>(shot.pixel % w), static_cast<float>(shot.pixel / w), 1};
  if (shot.whole) return part;
  part.side_px /= static_cast<float>(side);
  part.left_px += static_cast<float>(shot.sample % side) * part.side_px;
  part.top_px += static_cast<float>(shot.sample / side) * part.side_px;
  return part;
}

/// What the shots from `first` on bring at instant k.
void LightMeter::light_of_shots(const CameraRays& camera, std::size_t k, std::span<const Instant> instants,
                                const render::ContentFrame& frame, SampleLight& light, std::size_t first) {
  const SampleRays& rays = camera.samples;
  light.active_e.resize(shots_.size());
  light.range_m.resize(shots_.size());
  light.ambient_e.resize(background_.size());
  Returns::Seen& seen = scratch_[k].seen;
  std::vector<PicturePart>& parts = scratch_[k].parts;
  parts.resize(shots_.size());
  const Air air(frame, band_, instants[k].T_world_sensor.translation().z());
  const bool clear = air.clear();
  const OffAxis off_axis(model_);
  const Instant& shared_at = instants[shared_instant(instants.size())];
  const bool moved = shared_at.T_world_sensor.matrix() != instants[k].T_world_sensor.matrix();
  if (moved)
    returns_.see(model_, instants[k].T_world_sensor.linear().transpose().cast<float>(), shift_of(instants, k),
                 first, seen);
  each(shots_.size() - first, [&](std::size_t at) {
    const std::size_t i = first + at;
    const Shot& shot = shots_[i];
    const Hit& hit = hits_[i];
    light.active_e[i] = light.range_m[i] = 0;
    if (!background_.empty()) light.ambient_e[i] = 0;
    parts[i] = {0, 0, 0};
    if (shot.instant != k && !shot.shared) return;
    PicturePart part = part_of(shot, rays);
    const bool middle = shot.whole && !plane_[shot.pixel].isZero();
    const SampleRays& of = middle ? camera.middles : rays;
    const std::size_t sample = middle ? shot.pixel : shot.pixel * rays.each() + shot.sample;
    float range_m = hit.range_m, gain = of.gain[sample], intensity = of.intensity_w_per_sr[sample],
          rise = rays_[i].direction[2], back = 0;
    if (shot.instant != k && moved && gain > 0) {
      if (std::isnan(seen.u_px[i])) return;
      // As much larger as it is nearer.
      const float scale = hit.nothing() ? 1.0F : std::clamp(hit.range_m / seen.range_m[i], 0.5F, 2.0F);
      part.left_px = seen.u_px[i] + scale * (part.left_px - of.u_px[sample]);
      part.top_px = seen.v_px[i] + scale * (part.top_px - of.v_px[sample]);
      part.side_px *= scale;
      range_m = seen.range_m[i];
      gain = off_axis.gain(seen.off_axis_cos[i]);
      intensity = off_axis.intensity_w_per_sr(seen.off_axis_cos[i]);
      rise = seen.rise[i];
      back = seen.remission[i];
    } else if (!hit.nothing()) {
      back = remission(hit, model_.sampling.retro_gain);
    }
    parts[i] = part;
    if (!background_.empty()) light.ambient_e[i] = electrons(gain * background_[i]);
    if (hit.nothing()) return;
    float e = Math::tof_active_electrons(gain, intensity, range_m, back);
    if (!clear) e *= air.transmission(static_cast<double>(range_m), static_cast<double>(rise));
    light.active_e[i] = electrons(e);
    light.range_m[i] = range_m;
  });
  for (std::size_t i = first; i < shots_.size(); ++i) {
    const PicturePart& part = parts[i];
    if (!(part.side_px > 0)) continue;
    const auto sample = static_cast<std::uint32_t>(i);
    if (shots_[i].instant == k || !moved)
      light.parts.add(shots_[i].pixel, sample, part.side_px * part.side_px);
    else
      part.each_pixel(rays.width_px, rays.height_px, [&](std::size_t p, float area_px) {
        // A pixel that sees something that moves has what was cast now.
        if (moving_px_[p] == 0) light.parts.add(p, sample, area_px);
      });
  }
}

/// What at an instant lacks too much of what was met at another, behind edges and at the border of the
/// picture, has its samples cast at that too, and no others.
void LightMeter::aim_at_holes(const SampleRays& rays, std::span<SampleLight> lights) {
  const std::size_t pixels = rays.pixels();
  for (std::size_t k = 0; k < lights.size(); ++k)
    for (std::size_t i = 0; i < pixels; ++i) {
      const std::uint32_t p = shots_[i].pixel;
      if (moving_px_[p] != 0 ||
          lights[k].parts.cover(p) >= (dark_px_[p] != 0 ? kLeastDarkCover : kLeastCover))
        continue;
      lights[k].parts.clear_pixel(p);
      for (std::size_t r = 0; r < rays.each(); ++r)
        shots_.push_back({p, static_cast<std::uint16_t>(r), static_cast<std::uint16_t>(k), false, false});
    }
}

}  // namespace rigor::tof
