#include "sim/render/scene/scene_picture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "sensor-hal/models/wide.h"
#include "sim/render/scene/scene_light.h"

namespace rigor::render {
namespace {

/// What a ray meets: -1 the sky, 0 the ground, from kFaces on a face of a body.
constexpr std::int32_t kSky = -1, kGround = 0, kFaces = 8;

/// What the rays of a row meet; padded, so that loops need no remainder.
struct RowBuffer {
  std::vector<float> t;  ///< distance along the optical axis, metres
  std::vector<std::int32_t> seen;
};

constexpr int kLanes = 8;
constexpr int padded(int n) { return (n + kLanes - 1) / kLanes * kLanes; }

/// The slabs of a box: where the ray enters, and by which face.
RIGOR_WIDE void meet_box(const FrameRays r, const RayRow& w, int count, std::int32_t code,
                         float* __restrict t, std::int32_t* __restrict seen) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float dx = away_from_zero(r.axis[0] + r.right[0] * u + r.down[0] * v);
    const float dy = away_from_zero(r.axis[1] + r.right[1] * u + r.down[1] * v);
    const float dz = away_from_zero(r.axis[2] + r.right[2] * u + r.down[2] * v);
    const float ix = 1.0f / dx, iy = 1.0f / dy, iz = 1.0f / dz;
    const float ex = -r.origin[0] * ix - std::abs(ix), lx = -r.origin[0] * ix + std::abs(ix);
    const float ey = -r.origin[1] * iy - std::abs(iy), ly = -r.origin[1] * iy + std::abs(iy);
    const float ez = -r.origin[2] * iz - std::abs(iz), lz = -r.origin[2] * iz + std::abs(iz);
    const float exy = ex > ey ? ex : ey, lxy = lx < ly ? lx : ly;
    const float enter = exy > ez ? exy : ez, leave = lxy < lz ? lxy : lz;
    const std::int32_t face_x = dx < 0 ? 1 : 0, face_y = dy < 0 ? 3 : 2, face_z = dz < 0 ? 5 : 4;
    const std::int32_t face_xy = ex > ey ? face_x : face_y;
    const std::int32_t face = exy > ez ? face_xy : face_z;
    const bool hit = (enter < leave) & (enter > near) & (enter < t[i]);
    t[i] = hit ? enter : t[i];
    seen[i] = hit ? code + face : seen[i];
  }
}

/// Side 0, caps 4 (-z) and 5 (+z).
RIGOR_WIDE void meet_cylinder(const FrameRays r, const RayRow& w, int count, std::int32_t code,
                              float* __restrict t, std::int32_t* __restrict seen) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float dx = away_from_zero(r.axis[0] + r.right[0] * u + r.down[0] * v);
    const float dy = away_from_zero(r.axis[1] + r.right[1] * u + r.down[1] * v);
    const float dz = away_from_zero(r.axis[2] + r.right[2] * u + r.down[2] * v);
    const float iz = 1.0f / dz;
    const float ez = -r.origin[2] * iz - std::abs(iz), lz = -r.origin[2] * iz + std::abs(iz);
    const float a = dx * dx + dy * dy;
    const float cross = r.origin[0] * dy - r.origin[1] * dx;
    const float root2 = a - cross * cross;
    const float root = std::sqrt(root2 > 0.0f ? root2 : 0.0f);
    const float b = r.origin[0] * dx + r.origin[1] * dy;
    const float side = (-b - root) / a, out = (root - b) / a;
    const float enter = side > ez ? side : ez, leave = out < lz ? out : lz;
    const std::int32_t cap = dz < 0 ? 5 : 4;
    const bool hit = (root2 > 0.0f) & (enter < leave) & (enter > near) & (enter < t[i]);
    t[i] = hit ? enter : t[i];
    seen[i] = hit ? code + (side > ez ? 0 : cap) : seen[i];
  }
}

struct GroundLimits {
  float least_x, least_y, most_x, most_y;
};
RIGOR_WIDE void meet_ground(const FrameRays r, const RayRow& w, const GroundLimits& limits, int count,
                            float* __restrict t, std::int32_t* __restrict seen) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float at = -r.origin[2] / away_from_zero(r.axis[2] + r.right[2] * u + r.down[2] * v);
    const float x = r.origin[0] + at * (r.axis[0] + r.right[0] * u + r.down[0] * v);
    const float y = r.origin[1] + at * (r.axis[1] + r.right[1] * u + r.down[1] * v);
    const bool hit = (at > near) & (at < t[i]) & (x >= limits.least_x) & (x <= limits.most_x) &
                     (y >= limits.least_y) & (y <= limits.most_y);
    t[i] = hit ? at : t[i];
    seen[i] = hit ? kGround : seen[i];
  }
}

RIGOR_WIDE void least_and_most(const float* __restrict values, int count, float* __restrict least,
                               float* __restrict most) {
  for (int i = 0; i < count; i += kLanes)
    for (int k = 0; k < kLanes; ++k) {
      const float v = values[i + k];
      least[k] = v < least[k] ? v : least[k];
      most[k] = v > most[k] ? v : most[k];
    }
}

RIGOR_WIDE void ground_points(const FrameRays r, const RayRow& w, int count, const float* __restrict t,
                              float* __restrict x, float* __restrict y) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    x[i] = r.origin[0] + t[i] * (r.axis[0] + r.right[0] * u + r.down[0] * v);
    y[i] = r.origin[1] + t[i] * (r.axis[1] + r.right[1] * u + r.down[1] * v);
  }
}

/// Bodies whose shadow may fall on the ground where the run meets it.
void shades_of_ground(const SceneFrame& frame, const SceneRun& run, SceneShades& shades) {
  alignas(32) float points[2][kRunRays], least[kLanes], most[kLanes];
  ground_points(frame.ground.rays, run.rays, run.padded_count, run.t, points[0], points[1]);
  Eigen::AlignedBox2d box;
  for (int k = 0; k < 2; ++k) {
    for (int i = run.rays.count; i < run.padded_count; ++i) points[k][i] = points[k][0];
    std::fill_n(least, kLanes, points[k][0]);
    std::fill_n(most, kLanes, points[k][0]);
    least_and_most(points[k], run.padded_count, least, most);
    box.min()[k] = static_cast<double>(*std::min_element(least, least + kLanes));
    box.max()[k] = static_cast<double>(*std::max_element(most, most + kLanes));
  }
  const double middle = frame.ground.across.dot(box.center());
  const double reach = 0.5 * frame.ground.across.cwiseAbs().dot(box.sizes());
  Eigen::AlignedBox1d across;
  across.extend(Eigen::Matrix<double, 1, 1>(middle - reach));
  across.extend(Eigen::Matrix<double, 1, 1>(middle + reach));
  for (std::size_t k = 0; k < frame.footprints.size(); ++k) {
    const Footprint& f = frame.footprints[k];
    if (f.box.intersects(box) && f.across.intersects(across))
      shades.add(frame.bodies[frame.footprint_bodies[k]]);
  }
}

RayRow part(const RayRow& r, int first, int count) {
  return {r.u + first, r.v + first, r.width_u + first, r.width_v + first, count, nullptr};
}

/// What each ray of the row meets.
void meet(const SceneFrame& frame, const RayRow& rays, RowBuffer& buffer) {
  const auto size = static_cast<std::size_t>(padded(rays.count) + padded(kRunRays));
  buffer.t.assign(size, std::numeric_limits<float>::infinity());
  buffer.seen.assign(size, kSky);
  const std::span<const Eigen::AlignedBox2f> tiles(rays.tiles,
                                                   static_cast<std::size_t>(tiles_of(rays.count)));
  Eigen::AlignedBox2f all;
  for (const Eigen::AlignedBox2f& tile : tiles) all.extend(tile);
  for (std::size_t b = 0; b < frame.bodies.size(); ++b) {
    const FrameBody& body = frame.bodies[b];
    if (body.seen.isEmpty() || !body.seen.intersects(all)) continue;
    std::size_t first = 0, end = tiles.size();
    while (first < end && !tiles[first].intersects(body.seen)) ++first;
    while (end > first && !tiles[end - 1].intersects(body.seen)) --end;
    if (first == end) continue;
    const int from = static_cast<int>(first) * kRayTile,
              to = std::min(static_cast<int>(end) * kRayTile, rays.count);
    const auto code = kFaces + 8 * static_cast<std::int32_t>(b);
    (body.cylinder ? meet_cylinder : meet_box)(body.rays, part(rays, from, to - from), padded(to - from),
                                               code, buffer.t.data() + from, buffer.seen.data() + from);
  }
  if (!frame.has_ground) return;
  const FrameGround& g = frame.ground;
  meet_ground(g.rays, rays, {g.least.x(), g.least.y(), g.most.x(), g.most.y()}, padded(rays.count),
              buffer.t.data(), buffer.seen.data());
}

/// The light of rays that all meet `seen`.
void shade(const SceneFrame& frame, std::int32_t seen, const SceneRun& run) {
  thread_local SceneShades shades;
  shades.clear();
  if (seen == kSky) {
    light_of_sky(frame, run);
  } else if (seen == kGround) {
    if (frame.sun_up && frame.ground.cos_sun > 0) shades_of_ground(frame, run, shades);
    light_of_ground(frame, shades, run);
  } else {
    const FrameBody& body = frame.bodies[static_cast<std::size_t>((seen - kFaces) / 8)];
    for (std::uint32_t k = 0; k < body.casters; ++k)
      shades.add(frame.bodies[frame.casters[body.first_caster + k]]);
    light_of_body(frame, body, (seen - kFaces) % 8, shades, run);
  }
}

/// Rays that meet the same, gathered from their places in a row.
struct Gathered {
  alignas(32) float u[kRunRays], v[kRunRays], width_u[kRunRays], width_v[kRunRays], t[kRunRays],
      lit[kRunRays], light[3][kRunRays];
};

/// Places of the rays of a row, those that meet the same beside each other.
class Groups {
 public:
  void of(std::span<const std::int32_t> seen) {
    met_.clear();
    group_.resize(seen.size());
    place_.resize(seen.size());
    std::size_t last = 0;
    for (std::size_t i = 0; i < seen.size(); ++i) {
      if (met_.empty() || met_[last].seen != seen[i]) {
        last = 0;
        while (last < met_.size() && met_[last].seen != seen[i]) ++last;
        if (last == met_.size()) met_.push_back({seen[i], 0});
      }
      ++met_[last].end;
      group_[i] = last;
    }
    std::size_t first = 0;
    for (Met& m : met_) first += std::exchange(m.end, first);
    for (std::size_t i = 0; i < seen.size(); ++i) place_[met_[group_[i]].end++] = i;
  }
  struct Met {
    std::int32_t seen;
    std::size_t end;  ///< in places()
  };
  [[nodiscard]] const std::vector<Met>& met() const { return met_; }
  [[nodiscard]] const std::vector<std::size_t>& places() const { return place_; }

 private:
  std::vector<Met> met_;
  std::vector<std::size_t> group_, place_;
};

thread_local RowBuffer row_buffer;

}  // namespace

void draw_row(const SceneFrame& frame, const RayRow& rays, int channels, const std::array<float*, 3>& light,
              std::int32_t* met) {
  if (frame.in_the_dark) {
    for (int c = 0; c < channels; ++c) std::fill_n(light[static_cast<std::size_t>(c)], rays.count, 0.0f);
    std::fill_n(met, rays.count, 0);
    return;
  }
  meet(frame, rays, row_buffer);
  alignas(32) float lit[kRunRays];
  SceneRun run;
  run.lit = lit;
  run.channels = channels;
  for (int x = 0; x < rays.count; x += run.rays.count) {
    const std::int32_t* seen = row_buffer.seen.data() + x;
    int count = 1;
    while (count < kRunRays && x + count < rays.count && seen[count] == seen[0]) ++count;
    run.rays = part(rays, x, count);
    run.padded_count = padded(count);
    run.t = row_buffer.t.data() + x;
    for (std::size_t c = 0; c < 3; ++c) run.out[c] = light[c] == nullptr ? nullptr : light[c] + x;
    shade(frame, seen[0], run);
    for (int i = 0; i < count; ++i) met[x + i] = 2 * seen[0] + (lit[i] > 0.0f ? 1 : 0);
  }
}

void draw_rays(const SceneFrame& frame, const RayRow& rays, int channels,
               const std::array<float*, 3>& light) {
  if (frame.in_the_dark) {
    for (int c = 0; c < channels; ++c) std::fill_n(light[static_cast<std::size_t>(c)], rays.count, 0.0f);
    return;
  }
  meet(frame, rays, row_buffer);
  thread_local Groups groups;
  thread_local Gathered g;
  groups.of({row_buffer.seen.data(), static_cast<std::size_t>(rays.count)});
  SceneRun run;
  run.lit = g.lit;
  run.t = g.t;
  run.channels = channels;
  for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c) run.out[c] = g.light[c];
  std::size_t first = 0;
  for (const auto& [seen, end] : groups.met())
    while (first < end) {
      const std::size_t count = std::min<std::size_t>(end - first, kRunRays);
      const std::size_t* place = groups.places().data() + first;
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t i = place[k];
        g.u[k] = rays.u[i], g.v[k] = rays.v[i];
        g.width_u[k] = rays.width_u[i], g.width_v[k] = rays.width_v[i];
        g.t[k] = row_buffer.t[i];
      }
      run.rays = {g.u, g.v, g.width_u, g.width_v, static_cast<int>(count), nullptr};
      run.padded_count = padded(run.rays.count);
      for (std::size_t k = count; k < static_cast<std::size_t>(run.padded_count); ++k)
        for (float* row : {g.u, g.v, g.width_u, g.width_v, g.t}) row[k] = row[0];
      shade(frame, seen, run);
      for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c)
        for (std::size_t k = 0; k < count; ++k) light[c][place[k]] = g.light[c][k];
      first += count;
    }
}

}  // namespace rigor::render
