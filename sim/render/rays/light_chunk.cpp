#include "sim/render/rays/light_chunk.h"

#include <cmath>
#include <optional>

namespace rigor::render::light {
namespace {

/// Second word of the draws' counters: nobody else's effect.
constexpr std::uint32_t kSkyDraws = 0x4C490001U, kGatherDraws = 0x4C490003U, kGatherSkyDraws = 0x4C490006U;
/// Reflections that a gathering path follows: leaves send on nine tenths of 850 nm.
constexpr unsigned kGatherBounces = 64;
/// What a lamp adds is not asked for shadows where it is less than this share of the light that is there.
constexpr float kLampMatters = 1e-3F;
/// Angle that a sky ray stands for when it looks up a colour.
constexpr float kSkyRaySpread_rad = 0.2F;
/// Points lie in one plane that leave it by no more than this share of their range.
constexpr float kFlat = 1e-3F;

/// About a normal with density cos / pi.
Vec3 cosine_direction(Vec3 n, float u, float v) {
  Vec3 a, b;
  frame_about(n, a, b);
  const float r = std::sqrt(u), angle = 2 * kPi * v;
  return a * (r * std::cos(angle)) + b * (r * std::sin(angle)) + n * std::sqrt(std::max(1.0F - u, 0.0F));
}

/// Paths from a point, of a leaf from each side, of `paths` that are asked for.
unsigned paths_of(const Point& p, unsigned paths) { return p.patch.translucent ? 1 : paths; }
/// Rays from there, of a leaf from each side, that ask for the sky.
unsigned sky_rays_of(const Point& p) { return GatheredSky::kMostRays / (p.patch.translucent ? 2 : 1); }
/// Of all rays that say how much of the sky is free there.
float part_of_rays(const Point& p, unsigned paths) {
  return 1.0F / static_cast<float>(paths_of(p, paths) + sky_rays_of(p));
}

/// A direction about a bent normal may lead through the surface: the same on the surface's own side. `side`:
/// 1 or -1, of the normal.
Vec3 leaving(Vec3 direction, Vec3 geometric_normal, float side) {
  const float out_of = side * dot(direction, geometric_normal);
  return out_of > 0 ? direction : direction - geometric_normal * (2 * side * out_of);
}

}  // namespace

Chunk::Chunk(const ChunkInput& in)
    : in_(in),
      points_of_(in.scene, in.surfaces, in.frame, in.query.bands),
      key_{static_cast<std::uint32_t>(in.query.seed), static_cast<std::uint32_t>(in.query.seed >> 32U)} {}

std::array<float, 4> Chunk::draws(std::size_t index, unsigned purpose, unsigned k, unsigned segment) const {
  const auto& numbers = in_.query.numbers;
  const std::uint32_t number = numbers.empty() ? static_cast<std::uint32_t>(index) : numbers[index];
  const auto w = models::philox({number, purpose, k, segment}, key_);
  return {unit_draw(w[0]), unit_draw(w[1]), unit_draw(w[2]), unit_draw(w[3])};
}

void Chunk::load_rays(std::size_t first, unsigned n) {
  const LightQuery& q = in_.query;
  for (unsigned i = 0; i < n; ++i) {
    const Ray& r = q.rays[first + i];
    const Vec3 o = start_of(r);
    const float origin[3] = {o.x, o.y, o.z};
    rays_.set(i, origin, r.direction, q.near_m, r.far_m, r.time);
  }
}

Vec3 Chunk::start_of(const Ray& r) const {
  return Vec3{static_cast<float>(in_.origin.x()), static_cast<float>(in_.origin.y()),
              static_cast<float>(in_.origin.z())} +
         light::from(r.origin);
}

bool Chunk::is_ray(const Ray& r) const {
  const Vec3 d = light::from(r.direction);
  return finite(start_of(r)) && finite(d) && std::abs(dot(d, d) - 1.0F) < 0.03F;
}

void Chunk::nothing_met(const Ray& r, LightSample& s) const {
  const Vec3 o = start_of(r), d = light::from(r.direction);
  const float way = std::min(r.far_m, 1e7F);
  const Bands4 l =
      in_.frame.through_air(in_.frame.nothing_met(d, in_.query.spread_rad), o.z, o.z + d.z * way, way);
  for (int b = 0; b < 4; ++b) s.radiance[b] = l[b];
  s.range_m = std::numeric_limits<float>::infinity();
  s.sky_share = 1;
}

void Chunk::sky_only(std::size_t first, std::span<LightSample> samples) {
  const auto n = static_cast<unsigned>(samples.size());
  load_rays(first, n);
  const std::array<float, kChunk> half_width_m{};  // where they start
  std::array<float, kChunk> share;
  in_.scene.sky_share(rays_, n, {half_width_m.data(), 0.5F * in_.query.spread_rad}, share.data());
  for (unsigned i = 0; i < n; ++i) {
    const Ray& r = in_.query.rays[first + i];
    LightSample& s = samples[i];
    s = {};
    if (!is_ray(r)) continue;
    s.range_m = 0;
    if (!(share[i] > 0)) continue;
    nothing_met(r, s);
    s.sky_share = share[i];
  }
}

void Chunk::first_intersections(std::size_t first, std::span<LightSample> samples) {
  const LightQuery& q = in_.query;
  const auto n = static_cast<unsigned>(samples.size());
  load_rays(first, n);
  in_.scene.intersect(rays_, n, true, in_.seen);
  n_ = 0;
  for (unsigned i = 0; i < n; ++i) {
    const Ray& r = q.rays[first + i];
    LightSample& s = samples[i];
    s = {};
    if (!is_ray(r)) continue;
    const Vec3 o = start_of(r), d = light::from(r.direction);
    const Intersection m = rays_.intersection(i);
    if (m.nothing()) {
      nothing_met(r, s);
      continue;
    }
    Point& p = points_[n_++];
    points_of_.fetch(o, d, r.time, m, q.spread_rad, p);
    p.ray = i;
    p.light = Bands4{};
    s.range_m = p.range_m;
    s.normal[0] = p.normal.x;
    s.normal[1] = p.normal.y;
    s.normal[2] = p.normal.z;
    s.node = p.node;
  }
}

void Chunk::add_lamps() {
  for (const Lamp& lamp : in_.frame.lamps) {
    std::array<unsigned, kChunk> who;
    std::array<Bands4, kChunk> adds;
    unsigned n = 0;
    for (unsigned i = 0; i < n_; ++i) {
      Point& p = points_[i];
      const Vec3 to = lamp.place - p.place;
      const Bands4 l = lit_by_lamp(p.patch, p.view, p.normal, to, lamp.intensity);
      if (!(largest(l) > 0)) continue;
      if (!in_.query.shadows || !(largest(l) > kLampMatters * largest(p.light))) {
        p.light += l;
        continue;
      }
      const float far_m = length(to);
      const Vec3 o = off_surface(p.place, p.geometric_normal, to), d = unit(lamp.place - o, p.normal);
      const float origin[3] = {o.x, o.y, o.z}, direction[3] = {d.x, d.y, d.z};
      rays_.set(n, origin, direction, 0, far_m * (1 - 1e-5F), p.time, kShadowMask);
      who[n] = i;
      adds[n++] = l;
    }
    if (n == 0) continue;
    std::array<std::uint8_t, kChunk> hidden;
    in_.scene.occluded(rays_, n, true, hidden.data());
    shadow_rays += n;
    for (unsigned i = 0; i < n; ++i)
      if (hidden[i] == 0) points_[who[i]].light += adds[i];
  }
}

Chunk::Surroundings Chunk::surroundings(const Point& p, const Mirror& m) {
  std::optional<GatheredLight::About> about;
  if (in_.gathered != nullptr) about.emplace(*in_.gathered, p.place, p.range_m, found_);
  const auto irradiance = [&](Vec3 n, Bands4 open) { return about ? about->irradiance(n, open) : open; };
  Surroundings s;
  s.front = irradiance(p.normal, in_.frame.irradiance(p.normal));
  if (p.patch.translucent) s.behind = irradiance(-p.normal, in_.frame.irradiance(-p.normal));
  if (!any(m)) return s;
  s.mirrored = in_.frame.irradiance(m.direction);
  s.seen = min(irradiance(m.direction, s.mirrored) / max(s.mirrored, all_bands(1e-20F)), all_bands(1));
  return s;
}

bool Chunk::shares_from(unsigned first, std::array<Mirror, kPacket>& mirrors) const {
  const Point& a = points_[first];
  if (!in_.query.packets || a.ray % kPacket != 0 || first + kPacket > n_ ||
      points_[first + kPacket - 1].ray != a.ray + kPacket - 1)
    return false;
  for (unsigned i = 0; i < kPacket; ++i) {
    const Point& p = points_[first + i];
    if (p.normal != a.normal || p.patch.translucent ||
        !(std::abs(dot(a.normal, p.place - a.place)) <= kFlat * a.range_m))
      return false;
    mirrors[i] = mirror_of(p.patch, p.view, p.normal);
    if (any(mirrors[i]) != any(mirrors[0])) return false;
  }
  return true;
}

void Chunk::add_surroundings(Point& p, const Mirror& m, const Surroundings& s) const {
  p.light += lit_all_round(p.patch, s.front, s.behind);
  if (any(m)) p.light += s.seen * m.share * mirrored_sky(in_.frame, m, s.mirrored);
}

void Chunk::add_open_sky() {
  std::array<Mirror, kPacket> mirrors;
  for (unsigned first = 0; first < n_;) {
    if (shares_from(first, mirrors)) {
      share_surroundings(std::span(points_).subspan(first, kPacket), mirrors);
      first += kPacket;
      continue;
    }
    Point& p = points_[first++];
    const Mirror m = mirror_of(p.patch, p.view, p.normal);
    add_surroundings(p, m, surroundings(p, m));
  }
}

void Chunk::share_surroundings(std::span<Point> points, const std::array<Mirror, kPacket>& mirrors) {
  // The first, the last, and the one that is farthest from the line between them.
  const Vec3 start = points.front().place, x = points.back().place - start;
  const float xx = dot(x, x), per_xx = 1.0F / std::max(xx, 1e-20F);
  std::size_t third = 0;
  float farthest = 0;
  for (std::size_t i = 1; i + 1 < points.size(); ++i) {
    const Vec3 way = points[i].place - start, off = way - x * (dot(way, x) * per_xx);
    if (const float apart = dot(off, off); apart > farthest) farthest = apart, third = i;
  }
  const Vec3 y = points[third].place - start;
  const float xy = dot(x, y), yy = dot(y, y), per_det = 1.0F / std::max(xx * yy - xy * xy, 1e-30F);
  const bool line = !(farthest > 1e-4F * yy);
  const Surroundings a = surroundings(points.front(), mirrors.front()),
                     b = surroundings(points.back(), mirrors.back()),
                     c = line ? a : surroundings(points[third], mirrors[third]);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vec3 way = points[i].place - start;
    const float along_x = dot(way, x), along_y = dot(way, y);
    // Barycentric in the triangle of the three.
    const float u =
        std::clamp(line ? along_x * per_xx : (along_x * yy - along_y * xy) * per_det, -1.0F, 2.0F);
    const float v = line ? 0.0F : std::clamp((along_y * xx - along_x * xy) * per_det, -1.0F, 2.0F);
    const auto between = [&](Bands4 at_a, Bands4 at_b, Bands4 at_c) {
      return not_negative(at_a + (at_b - at_a) * u + (at_c - at_a) * v);
    };
    add_surroundings(
        points[i], mirrors[i],
        {between(a.front, b.front, c.front), Bands4{}, between(a.mirrored, b.mirrored, c.mirrored),
         min(between(a.seen, b.seen, c.seen), all_bands(1))});
  }
}

bool Chunk::scatter(const Point& p, std::size_t index, unsigned k, unsigned segment, Path& out) const {
  const MaterialSample& s = p.patch;
  const Bands4 front = s.glossy ? s.reflectance * (1.0F - s.metallic) : s.reflectance;
  const Bands4 back = s.translucent ? s.transmittance : Bands4{};
  const float forward = mean(front), through = mean(back);
  if (!(forward + through > 0)) return false;
  const auto u = draws(index, kSkyDraws, k, segment);
  const float chance = forward / (forward + through);
  const bool passes = u[2] > chance;  // a draw may be 1, where nothing passes
  out.share *= passes ? back / (1.0F - chance) : front / chance;
  if (segment > 0) {
    // A path that carries a share of the light that it began with, in the band where that is most, goes on
    // with that chance, and then carries all of it.
    const float began = out.mirrored || in_.query.sky_rays < 1 ? 1 : static_cast<float>(in_.query.sky_rays);
    const float goes_on = std::clamp(began * largest(out.share), 0.05F, 1.0F);
    if (u[3] >= goes_on) return false;
    out.share /= goes_on;
  }
  const float side = passes ? -1.0F : 1.0F;
  out.direction = leaving(cosine_direction(p.normal * side, u[0], u[1]), p.geometric_normal, side);
  out.place = off_surface(p.place, p.geometric_normal, out.direction);
  out.time = p.time;
  return true;
}

void Chunk::begin_paths(std::size_t first, unsigned k) {
  const auto each = 1.0F / static_cast<float>(in_.query.sky_rays);
  paths_ = 0;
  for (unsigned i = 0; i < n_; ++i) {
    const Point& p = points_[i];
    Path way;
    way.share = all_bands(each);
    way.point = i;
    asked_[i] += 1;
    if (scatter(p, first + p.ray, k, 0, way)) path_[paths_++] = way;
    if (k > 0) continue;
    const Mirror m = mirror_of(p.patch, p.view, p.normal);
    if (!any(m)) continue;
    if (m.sharp > 0 && dot(m.direction, p.geometric_normal) > 0) {
      way.share = m.share * m.sharp;
      way.direction = unit(m.direction, p.normal);
      way.place = off_surface(p.place, p.geometric_normal, way.direction);
      way.time = p.time;
      way.mirrored = true;
      path_[paths_++] = way;
    }
  }
}

void Chunk::follow_paths(std::size_t first, unsigned k, unsigned bounces) {
  std::array<std::uint8_t, 2 * kChunk> hidden;
  // A path's own width is not known, and the mean over many paths is soft without it.
  const SunRays sun = in_.query.sun_rays == SunRays::wide ? SunRays::to_middle : in_.query.sun_rays;
  for (unsigned segment = 0; segment <= bounces && paths_ > 0; ++segment) {
    for (unsigned i = 0; i < paths_; ++i) {
      const Path& w = path_[i];
      const float origin[3] = {w.place.x, w.place.y, w.place.z},
                  direction[3] = {w.direction.x, w.direction.y, w.direction.z};
      rays_.set(i, origin, direction, 0, std::numeric_limits<float>::infinity(), w.time, kShadowMask);
    }
    sky_rays += paths_;
    const bool last = segment == bounces;
    if (last)
      in_.scene.occluded(rays_, paths_, false, hidden.data(), in_.followed);
    else
      in_.scene.intersect(rays_, paths_, false, in_.followed);
    unsigned left = 0;
    for (unsigned i = 0; i < paths_; ++i) {
      Path w = path_[i];
      const Intersection m = last ? Intersection{} : rays_.intersection(i);
      if (segment == 0) first_m_[w.point] = m.range_m;
      if (last ? hidden[i] == 0 : m.nothing()) {
        points_[w.point].light += w.share * in_.frame.surroundings(w.direction);
        if (segment == 0 && !w.mirrored) open_[w.point] += 1;
        continue;
      }
      if (last) continue;
      Point& p = met_[left];
      points_of_.fetch(w.place, w.direction, w.time, m, kSkyRaySpread_rad, p);
      p.ray = points_[w.point].ray;
      // What is sent on is diffuse: mirrors on the way would need many more rays.
      p.patch.glossy = p.patch.glossy && p.patch.metallic > 0;
      p.light = Bands4{};
      path_[left++] = w;
    }
    paths_ = left;
    if (paths_ == 0) break;
    sky_rays += add_sun(std::span(met_.data(), paths_), first, 1 + k * 65U + segment, sun);
    left = 0;
    for (unsigned i = 0; i < paths_; ++i) {
      Path w = path_[i];
      points_[w.point].light += w.share * met_[i].light;
      if (scatter(met_[i], first + met_[i].ray, k, 2 * segment + (w.mirrored ? 2U : 1U), w))
        path_[left++] = w;
    }
    paths_ = left;
  }
}

void Chunk::add_sky(std::size_t first) {
  const auto rays = static_cast<unsigned>(in_.query.sky_rays);
  std::fill_n(open_.begin(), n_, 0.0F);
  std::fill_n(asked_.begin(), n_, 0.0F);
  for (unsigned k = 0; k < rays; ++k) {
    begin_paths(first, k);
    follow_paths(first, k, static_cast<unsigned>(in_.query.bounces));
  }
  for (unsigned i = 0; i < n_; ++i) {
    Point& p = points_[i];
    if (const Mirror m = mirror_of(p.patch, p.view, p.normal); any(m) && m.sharp < 1)
      p.light +=
          m.share * in_.frame.irradiance(m.direction) * ((1.0F - m.sharp) / kPi * open_[i] / asked_[i]);
  }
}

void Chunk::gather_sky(std::size_t first, unsigned paths, std::vector<GatheredSky>& out) {
  constexpr unsigned kRays = GatheredSky::kMostRays;
  static_assert(kPacketRays % kRays == 0);
  std::array<std::uint8_t, kPacketRays> hidden;
  for (unsigned begin = 0; begin < n_; begin += kPacketRays / kRays) {
    const unsigned end = std::min(begin + kPacketRays / kRays, n_);
    const std::size_t first_sky = out.size();
    unsigned n = 0;
    for (unsigned i = begin; i < end; ++i) {
      const Point& p = points_[i];
      const unsigned sides = p.patch.translucent ? 2 : 1;
      for (unsigned behind = 0; behind < sides; ++behind) {
        const float side = behind == 1 ? -1.0F : 1.0F;
        GatheredSky& sky = out.emplace_back();
        sky.place = p.place;
        sky.normal = p.normal * side;
        sky.range_m = p.range_m;
        sky.start = off_surface(p.place, p.geometric_normal, p.geometric_normal * side);
        sky.rays = sky_rays_of(p);
        sky.part_of_rays = part_of_rays(p, paths);
        const auto u = draws(first + p.ray, kGatherSkyDraws, behind, 0);
        for (unsigned k = 0; k < sky.rays; ++k) {
          // In rings of the same weight, a golden turn from each to the next.
          const float turn = u[1] + 0.618034F * static_cast<float>(k);
          const Vec3 d = leaving(
              cosine_direction(sky.normal, (static_cast<float>(k) + u[0]) / static_cast<float>(sky.rays),
                               turn - std::floor(turn)),
              p.geometric_normal, side);
          sky.direction[k] = d;
          sky.open += in_.frame.surroundings(d);
          const float origin[3] = {sky.start.x, sky.start.y, sky.start.z}, direction[3] = {d.x, d.y, d.z};
          rays_.set(n++, origin, direction, 0, std::numeric_limits<float>::infinity(), p.time, kShadowMask);
        }
      }
    }
    in_.scene.occluded_by_fronts(rays_, n, hidden.data(), in_.followed);
    n = 0;
    for (std::size_t s = first_sky; s < out.size(); ++s)
      for (unsigned k = 0; k < out[s].rays; ++k)
        if (hidden[n++] == 0) {
          out[s].free |= 1U << k;
          out[s].sky += in_.frame.surroundings(out[s].direction[k]);
        }
  }
}

void Chunk::gather(std::size_t first, std::size_t rays, unsigned paths, Gathered& gathered,
                   std::span<const std::uint8_t> again) {
  std::vector<GatheredPath>& out = gathered.paths;
  std::array<LightSample, kChunk> samples;
  first_intersections(first, std::span(samples.data(), rays));
  if (again.empty()) gather_sky(first, paths, gathered.skies);
  constexpr auto kNone = std::numeric_limits<std::size_t>::max();
  std::array<std::size_t, kChunk> at;  // of the point's path in `out`
  std::array<std::array<std::size_t, kMostPaths>, kChunk> once_more;
  if (!again.empty())
    for (auto& of_ray : once_more) of_ray.fill(kNone);
  for (std::size_t i = 0; i < again.size(); ++i)
    if (again[i] != 0) once_more[out[i].ray][out[i].draw] = i;
  for (unsigned k = 0; k < paths && n_ > 0; ++k) {
    paths_ = 0;
    for (unsigned i = 0; i < n_; ++i) {
      Point& p = points_[i];
      p.light = Bands4{};
      open_[i] = 0;
      at[i] = kNone;
      // One path for each side of a leaf: many leaves share the cell that they lie in.
      if (p.patch.translucent && k >= 2) continue;
      const bool behind = p.patch.translucent && k == 1;
      const std::size_t place = again.empty() ? out.size() : once_more[p.ray][k];
      if (place == kNone) continue;
      at[i] = place;
      const float side = behind ? -1.0F : 1.0F;
      const auto u = draws(first + p.ray, kGatherDraws, k, 0);
      Path way;
      way.direction = leaving(cosine_direction(p.normal * side, u[0], u[1]), p.geometric_normal, side);
      way.place = off_surface(p.place, p.geometric_normal, way.direction);
      way.share = all_bands(1);
      way.point = i;
      way.time = p.time;
      path_[paths_++] = way;
      if (place == out.size()) out.emplace_back();
      out[place] = {.place = p.place,
                    .normal = p.normal * side,
                    .range_m = p.range_m,
                    .open = in_.frame.surroundings(way.direction),
                    .ray = static_cast<std::uint8_t>(p.ray),
                    .draw = static_cast<std::uint8_t>(k),
                    .part_of_paths = 1.0F / static_cast<float>(paths_of(p, paths)),
                    .part_of_rays = part_of_rays(p, paths),
                    .start = way.place,
                    .direction = way.direction};
    }
    follow_paths(first, k, kGatherBounces);
    for (unsigned i = 0; i < n_; ++i) {
      if (at[i] == kNone) continue;
      GatheredPath& path = out[at[i]];
      path.free = open_[i] > 0;
      path.scattered = path.free ? Bands4{} : points_[i].light;
      path.first_m = first_m_[i];
    }
  }
}

void Chunk::trace(std::size_t first, std::span<LightSample> samples) {
  if (in_.query.sky_only) {
    sky_only(first, samples);
    return;
  }
  first_intersections(first, samples);
  if (n_ == 0) return;
  const std::span points(points_.data(), n_);
  shadow_rays += in_.query.sun_rays == SunRays::wide ? add_wide_sun(points)
                                                     : add_sun(points, first, 0, in_.query.sun_rays);
  if (in_.query.sky_rays > 0)
    add_sky(first);
  else
    add_open_sky();
  if (!in_.frame.lamps.empty()) add_lamps();
  for (unsigned i = 0; i < n_; ++i) {
    const Point& p = points_[i];
    LightSample& s = samples[p.ray];
    const Bands4 l = in_.frame.through_air(p.light, p.place.z, p.place.z + p.view.z * s.range_m, s.range_m);
    for (int b = 0; b < 4; ++b) s.radiance[b] = l[b];
  }
}

}  // namespace rigor::render::light
