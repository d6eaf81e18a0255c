#include "sim/render/scene/scene_picture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "sensor-hal/models/wide.h"
#include "sim/render/scene/scene_light.h"

namespace rigor::render {
namespace {

/// What a pixel sees: -1 the sky, 0 the ground, from kFaces on a face of a body.
constexpr std::int32_t kSky = -1, kGround = 0, kFaces = 8;

/// Columns of one row with what they see; padded, so that loops need no remainder.
struct RowBuffer {
  std::vector<float> t;  ///< distance along the optical axis, metres
  std::vector<std::int32_t> seen;
  int first_column = 0;
};

constexpr int kLanes = 8;
constexpr int padded(int n) { return (n + kLanes - 1) / kLanes * kLanes; }

/// The slabs of a box: where the ray enters, and by which face.
RIGOR_WIDE void meet_box(const RowRays& r, int first_column, int count, std::int32_t code,
                         float* __restrict t, std::int32_t* __restrict seen) {
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = static_cast<float>(first_column + i);
    const float dx = away_from_zero(r.direction[0] + r.step[0] * u);
    const float dy = away_from_zero(r.direction[1] + r.step[1] * u);
    const float dz = away_from_zero(r.direction[2] + r.step[2] * u);
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
RIGOR_WIDE void meet_cylinder(const RowRays& r, int first_column, int count, std::int32_t code,
                              float* __restrict t, std::int32_t* __restrict seen) {
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = static_cast<float>(first_column + i);
    const float dx = away_from_zero(r.direction[0] + r.step[0] * u);
    const float dy = away_from_zero(r.direction[1] + r.step[1] * u);
    const float dz = away_from_zero(r.direction[2] + r.step[2] * u);
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
RIGOR_WIDE void meet_ground(const RowRays& r, const GroundLimits& limits, int first_column, int count,
                            float* __restrict t, std::int32_t* __restrict seen) {
  const float near = static_cast<float>(kSceneNear_m);
  for (int i = 0; i < count; ++i) {
    const float u = static_cast<float>(first_column + i);
    const float at = -r.origin[2] / away_from_zero(r.direction[2] + r.step[2] * u);
    const float x = r.origin[0] + at * (r.direction[0] + r.step[0] * u);
    const float y = r.origin[1] + at * (r.direction[1] + r.step[1] * u);
    const bool hit = (at > near) & (at < t[i]) & (x >= limits.least_x) & (x <= limits.most_x) &
                     (y >= limits.least_y) & (y <= limits.most_y);
    t[i] = hit ? at : t[i];
    seen[i] = hit ? kGround : seen[i];
  }
}

/// Bodies whose shadow may fall on the ground between the run's ends.
void shades_of_ground(const SceneFrame& frame, const RowRays& rays, const SceneRun& run, int y,
                      SceneShades& shades) {
  shades.clear();
  const auto point = [&](int i) {
    const float u = static_cast<float>(run.first_column + i);
    const float x = rays.origin[0] + run.t[i] * (rays.direction[0] + rays.step[0] * u);
    const float z = rays.origin[1] + run.t[i] * (rays.direction[1] + rays.step[1] * u);
    return Eigen::Vector2d(x, z);
  };
  const Eigen::Vector2d a = point(0), b = point(run.count - 1);
  Eigen::AlignedBox2d box(a);
  box.extend(b);
  Eigen::AlignedBox1d across;
  for (const Eigen::Vector2d& p : {a, b})
    across.extend(Eigen::Matrix<double, 1, 1>(frame.ground.across.dot(p)));
  for (std::size_t k = 0; k < frame.footprints.size(); ++k) {
    const Footprint& f = frame.footprints[k];
    if (f.box.intersects(box) && f.across.intersects(across))
      shades.add(frame.bodies[frame.footprint_bodies[k]], y);
  }
}

}  // namespace

void draw_scene_row(const SceneFrame& frame, int y, const PictureArea& area, int channels,
                    const std::array<float*, 3>& row) {
  thread_local RowBuffer buffer;
  thread_local SceneShades shades;
  const int width = area.x1 - area.x0;
  if (frame.in_the_dark) {
    for (int c = 0; c < channels; ++c) std::fill_n(row[static_cast<std::size_t>(c)], width, 0.0f);
    return;
  }
  const auto size = static_cast<std::size_t>(padded(width) + padded(kRunColumns));
  buffer.t.assign(size, std::numeric_limits<float>::infinity());
  buffer.seen.assign(size, kSky);
  for (std::size_t b = 0; b < frame.bodies.size(); ++b) {
    const FrameBody& body = frame.bodies[b];
    const int first = std::max(body.first_column, area.x0), end = std::min(body.end_column, area.x1);
    if (y < body.first_row || y >= body.end_row || first >= end) continue;
    const RowRays rays(body.rays, y);
    const auto code = kFaces + 8 * static_cast<std::int32_t>(b);
    (body.cylinder ? meet_cylinder : meet_box)(rays, first, padded(end - first), code,
                                               buffer.t.data() + (first - area.x0),
                                               buffer.seen.data() + (first - area.x0));
  }
  const RowRays camera(frame.camera_rays, y);
  RowRays ground;
  if (frame.has_ground) {
    ground = RowRays(frame.ground.rays, y);
    const FrameGround& g = frame.ground;
    meet_ground(ground, {g.least.x(), g.least.y(), g.most.x(), g.most.y()}, area.x0, padded(width),
                buffer.t.data(), buffer.seen.data());
  }
  SceneRun run;
  for (int x = 0; x < width; x += run.count) {
    const auto at = static_cast<std::size_t>(x);
    const std::int32_t seen = buffer.seen[at];
    run.first_column = area.x0 + x;
    run.count = 1;
    while (run.count < kRunColumns && x + run.count < width &&
           buffer.seen[at + static_cast<std::size_t>(run.count)] == seen)
      ++run.count;
    run.padded_count = padded(run.count);
    run.t = buffer.t.data() + at;
    run.channels = channels;
    for (std::size_t c = 0; c < 3; ++c) run.out[c] = row[c] == nullptr ? nullptr : row[c] + x;
    if (seen == kSky) {
      light_of_sky(frame, camera, run);
    } else if (seen == kGround) {
      if (frame.sun_up && frame.ground.cos_sun > 0)
        shades_of_ground(frame, ground, run, y, shades);
      else
        shades.clear();
      light_of_ground(frame, camera, ground, shades, run);
    } else {
      const FrameBody& body = frame.bodies[static_cast<std::size_t>((seen - kFaces) / 8)];
      shades.clear();
      for (std::uint32_t k = 0; k < body.casters; ++k)
        shades.add(frame.bodies[frame.casters[body.first_caster + k]], y);
      light_of_body(frame, camera, body, (seen - kFaces) % 8, y, shades, run);
    }
  }
}

}  // namespace rigor::render
