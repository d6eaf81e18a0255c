#include "sim/render/scene/scene_light.h"

#include <algorithm>

#include "sensor-hal/models/wide.h"

namespace rigor::render {
namespace {

/// A number for each pixel of a run.
struct alignas(32) Lanes {
  float v[kRunRays];
  void fill(float value, int count) { std::fill_n(v, count, value); }
};

/// What differs between the pixels of a run. The light of a channel is
/// ambient_0 + ambient_1 up + sun sunshine + specular highlight, each material's share mixed by `other`.
struct RunLight {
  Lanes up, sunshine, highlight, other;
  bool highlights = false, mixed = false;
};

RIGOR_WIDE void shade_box(const FrameRays r, const RayRow& w, const float* sun, int count,
                          const float* __restrict t, float* __restrict lit) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float ix = 1.0f / sun[0], iy = 1.0f / sun[1], iz = 1.0f / sun[2];
  const float hx = std::abs(ix), hy = std::abs(iy), hz = std::abs(iz);
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float cx = -(r.origin[0] + t[i] * (r.axis[0] + r.right[0] * u + r.down[0] * v)) * ix;
    const float cy = -(r.origin[1] + t[i] * (r.axis[1] + r.right[1] * u + r.down[1] * v)) * iy;
    const float cz = -(r.origin[2] + t[i] * (r.axis[2] + r.right[2] * u + r.down[2] * v)) * iz;
    const float exy = cx - hx > cy - hy ? cx - hx : cy - hy, lxy = cx + hx < cy + hy ? cx + hx : cy + hy;
    const float e = exy > cz - hz ? exy : cz - hz, leave = lxy < cz + hz ? lxy : cz + hz;
    const float enter = e > 0.0f ? e : 0.0f;
    lit[i] = leave > enter ? 0.0f : lit[i];
  }
}

RIGOR_WIDE void shade_cylinder(const FrameRays r, const RayRow& w, const float* sun, int count,
                               const float* __restrict t, float* __restrict lit) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float iz = 1.0f / sun[2], hz = std::abs(iz);
  const float a = sun[0] * sun[0] + sun[1] * sun[1], ia = 1.0f / a;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float x = r.origin[0] + t[i] * (r.axis[0] + r.right[0] * u + r.down[0] * v);
    const float y = r.origin[1] + t[i] * (r.axis[1] + r.right[1] * u + r.down[1] * v);
    const float cz = -(r.origin[2] + t[i] * (r.axis[2] + r.right[2] * u + r.down[2] * v)) * iz;
    const float cross = x * sun[1] - y * sun[0];
    const float root2 = a - cross * cross;
    const float root = std::sqrt(root2 > 0.0f ? root2 : 0.0f);
    const float b = x * sun[0] + y * sun[1];
    const float side = (-b - root) * ia, out = (root - b) * ia;
    const float e = side > cz - hz ? side : cz - hz, leave = out < cz + hz ? out : cz + hz;
    const float enter = e > 0.0f ? e : 0.0f;
    lit[i] = ((root2 > 0.0f) & (leave > enter)) ? 0.0f : lit[i];
  }
}

/// Normal of a cylinder's side, times `towards` (unit length, in the body's axes).
RIGOR_WIDE void cosines_of_side(const FrameRays r, const RayRow& w, const float* towards, int count,
                                const float* __restrict t, float* __restrict cosine) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float x = r.origin[0] + t[i] * (r.axis[0] + r.right[0] * u + r.down[0] * v);
    const float y = r.origin[1] + t[i] * (r.axis[1] + r.right[1] * u + r.down[1] * v);
    const float l2 = x * x + y * y;
    cosine[i] = (x * towards[0] + y * towards[1]) / std::sqrt(l2 > 1e-12f ? l2 : 1e-12f);
  }
}

/// n · d of each pixel: its normal times its ray (not of unit length).
RIGOR_WIDE void facing_side(const FrameRays r, const RayRow& w, float half_x, float half_y, int count,
                            const float* __restrict t, float* __restrict facing) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float dx = r.axis[0] + r.right[0] * u + r.down[0] * v,
                dy = r.axis[1] + r.right[1] * u + r.down[1] * v;
    const float x = r.origin[0] + t[i] * dx, y = r.origin[1] + t[i] * dy;
    const float l2 = x * x + y * y;
    facing[i] = (x * dx * half_x + y * dy * half_y) / std::sqrt(l2 > 1e-12f ? l2 : 1e-12f);
  }
}
RIGOR_WIDE void facing_plane(const FrameRays r, const RayRow& w, int axis, float scale, int count,
                             float* __restrict facing) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float a = scale * r.axis[axis], right = scale * r.right[axis], down = scale * r.down[axis];
  for (int i = 0; i < count; ++i) facing[i] = a + right * us[i] + down * vs[i];
}

/// GGX with Schlick's Fresnel term for a dielectric, F0 = 0.04, and the height-correlated visibility
/// approximated as 1 / (4 l.h^2) (Lazarov 2011); times the sun's cosine.
RIGOR_WIDE void highlight_run(const RayRow& w, const float* sun, float roughness, float other_roughness,
                              int count, const float* __restrict facing, const float* __restrict sunshine,
                              const float* __restrict other, float* __restrict highlight) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float inverse = 1.0f / std::sqrt(u * u + v * v + 1.0f);
    const float sun_view = -(sun[0] * u + sun[1] * v + sun[2]) * inverse;
    const float h2 = 2.0f + 2.0f * sun_view;
    const float h = 1.0f / std::sqrt(h2 > 1e-6f ? h2 : 1e-6f);
    const float nh0 = (sunshine[i] - facing[i] * inverse) * h;
    const float nh = nh0 > 0.0f ? nh0 : 0.0f;
    const float lh0 = (1.0f + sun_view) * h;
    const float lh = lh0 > 0.05f ? lh0 : 0.05f;
    const float rough = roughness + (other_roughness - roughness) * other[i];
    const float alpha2 = rough * rough * rough * rough;
    const float f = nh * nh * (alpha2 - 1.0f) + 1.0f;
    const float grazing = 1.0f - lh;
    const float fresnel = 0.04f + 0.96f * grazing * grazing * grazing * grazing * grazing;
    const float light = alpha2 / (3.14159265f * f * f) * fresnel / (4.0f * lh * lh) * sunshine[i];
    highlight[i] = rough < 1.0f ? light : 0.0f;
  }
}

RIGOR_WIDE_STEP float floor_of(float v) {
  const float whole = static_cast<float>(static_cast<std::int32_t>(v));
  return whole > v ? whole - 1.0f : whole;
}
RIGOR_WIDE_STEP float bounded(float v) {
  constexpr float kMost = 1e9f;
  const float low = v > -kMost ? v : -kMost;
  return low < kMost ? low : kMost;
}
RIGOR_WIDE_STEP float absolute(float v) { return v < 0.0f ? -v : v; }
RIGOR_WIDE_STEP float at_least(float v, float least) { return v > least ? v : least; }
RIGOR_WIDE_STEP float clamped(float v, float least, float most) {
  const float low = v > least ? v : least;
  return low < most ? low : most;
}
/// The integral of a square wave of period 2, which is +1 and -1 in turn, up to a constant.
RIGOR_WIDE_STEP float wave(float v) {
  const float half = 0.5f * v;
  return absolute(half - floor_of(half) - 0.5f);
}
/// Share of the odd cells of a unit chequered pattern within a box of width w about (x, y) (I. Quilez,
/// box-filtered checker).
RIGOR_WIDE_STEP float checker(float x, float y, float wx, float wy) {
  const float ix = 2.0f * (wave(x - 0.5f * wx) - wave(x + 0.5f * wx)) / wx;
  const float iy = 2.0f * (wave(y - 0.5f * wy) - wave(y + 0.5f * wy)) / wy;
  return 0.5f - 0.5f * ix * iy;
}

/// Where the rays meet the plane z = const of their frame, and how far apart the hits of neighbouring pixels
/// are there: the width of a pixel, the larger of that along the row and that along the column.
struct PlaneHit {
  Lanes x, y, width_x, width_y;
};
RIGOR_WIDE void hit_plane(const FrameRays r, const RayRow& w, float scale_x, float scale_y, int count,
                          const float* __restrict t, PlaneHit& __restrict out) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  const float* __restrict widths_u = w.width_u;
  const float* __restrict widths_v = w.width_v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    const float dx = r.axis[0] + r.right[0] * u + r.down[0] * v,
                dy = r.axis[1] + r.right[1] * u + r.down[1] * v;
    const float dz = away_from_zero(r.axis[2] + r.right[2] * u + r.down[2] * v);
    const float qx = dx / dz, qy = dy / dz;
    const float per_column = t[i] * widths_u[i], per_row = t[i] * widths_v[i];
    const float column_x = absolute(per_column * (r.right[0] - qx * r.right[2])),
                row_x = absolute(per_row * (r.down[0] - qx * r.down[2]));
    const float column_y = absolute(per_column * (r.right[1] - qy * r.right[2])),
                row_y = absolute(per_row * (r.down[1] - qy * r.down[2]));
    out.x.v[i] = bounded((r.origin[0] + t[i] * dx) * scale_x);
    out.y.v[i] = bounded((r.origin[1] + t[i] * dy) * scale_y);
    out.width_x.v[i] = at_least(bounded((column_x > row_x ? column_x : row_x) * scale_x), 1e-4f);
    out.width_y.v[i] = at_least(bounded((column_y > row_y ? column_y : row_y) * scale_y), 1e-4f);
  }
}

RIGOR_WIDE void checker_run(const PlaneHit& p, int count, float* __restrict other) {
  for (int i = 0; i < count; ++i) other[i] = checker(p.x.v[i], p.y.v[i], p.width_x.v[i], p.width_y.v[i]);
}

/// A board's outer edge is box-filtered too: the share of the pixel that lies on the board, times the mean of
/// the squares there. Positions are in squares from the centre.
RIGOR_WIDE void board_run(const PlaneHit& p, float half_x, float half_y, int count, float* __restrict other) {
  for (int i = 0; i < count; ++i) {
    const float wx = p.width_x.v[i], wy = p.width_y.v[i];
    const float inside_x = clamped((half_x - absolute(p.x.v[i])) / wx + 0.5f, 0.0f, 1.0f);
    const float inside_y = clamped((half_y - absolute(p.y.v[i])) / wy + 0.5f, 0.0f, 1.0f);
    const float room_x = at_least(half_x - 0.5f * wx, 0.0f), room_y = at_least(half_y - 0.5f * wy, 0.0f);
    other[i] = checker(clamped(p.x.v[i], -room_x, room_x) + half_x,
                       clamped(p.y.v[i], -room_y, room_y) + half_y, wx, wy) *
               inside_x * inside_y;
  }
}

RIGOR_WIDE_STEP float lattice(std::uint32_t x, std::uint32_t y) {
  std::uint32_t h = x * 0x9E3779B1u ^ y * 0x85EBCA77u;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return static_cast<float>(static_cast<std::int32_t>((h ^ (h >> 15)) >> 8)) * (1.0f / 16777216.0f);
}
RIGOR_WIDE_STEP float mixed(float a, float b, float t) { return a + (b - a) * t; }

constexpr int kNoiseCellsPerCell = 4;

/// 1 minus smooth noise of the given contrast, on a lattice that is anchored in the ground's frame. Noise
/// finer than a pixel averages out to its mean.
RIGOR_WIDE void noise_run(const PlaneHit& p, std::uint32_t base_x, std::uint32_t base_y, float contrast,
                          int count, float* __restrict factor) {
  for (int i = 0; i < count; ++i) {
    const float x = p.x.v[i] * kNoiseCellsPerCell, y = p.y.v[i] * kNoiseCellsPerCell;
    const float width = p.width_x.v[i] > p.width_y.v[i] ? p.width_x.v[i] : p.width_y.v[i];
    const float visible = clamped(1.5f - width * kNoiseCellsPerCell, 0.0f, 1.0f);
    const float cx = floor_of(bounded(x)), cy = floor_of(bounded(y));
    const float fx = x - cx, fy = y - cy;
    const float sx = fx * fx * (3.0f - 2.0f * fx), sy = fy * fy * (3.0f - 2.0f * fy);
    const std::uint32_t ix = base_x + static_cast<std::uint32_t>(static_cast<std::int32_t>(cx)),
                        iy = base_y + static_cast<std::uint32_t>(static_cast<std::int32_t>(cy));
    const float n = mixed(mixed(lattice(ix, iy), lattice(ix + 1, iy), sx),
                          mixed(lattice(ix, iy + 1), lattice(ix + 1, iy + 1), sx), sy);
    factor[i] = 1.0f - contrast * mixed(0.5f, n, visible);
  }
}

RIGOR_WIDE void plain_channel(const RunLight& l, float ambient_0, float ambient_1, float sun, int count,
                              float* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] = ambient_0 + ambient_1 * l.up.v[i] + sun * l.sunshine.v[i];
}
RIGOR_WIDE void mixed_channel(const RunLight& l, const float* a, const float* b, int count,
                              float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    const float s = l.other.v[i];
    out[i] = mixed(a[0], b[0], s) + mixed(a[1], b[1], s) * l.up.v[i] + mixed(a[2], b[2], s) * l.sunshine.v[i];
  }
}
RIGOR_WIDE void add_highlight(const RunLight& l, float specular, int count, float* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] += specular * l.highlight.v[i];
}
RIGOR_WIDE void multiply(const float* __restrict factor, int count, float* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] *= factor[i];
}

/// `factor` null: 1.
void put(const SceneFrame& frame, const RunLight& l, const SurfaceLight& m, const SurfaceLight& other,
         const float* factor, const SceneRun& run) {
  Lanes out;
  for (std::size_t c = 0; c < static_cast<std::size_t>(run.channels); ++c) {
    if (l.mixed) {
      const float a[3] = {m.ambient_0[c], m.ambient_1[c], m.sun[c]};
      const float b[3] = {other.ambient_0[c], other.ambient_1[c], other.sun[c]};
      mixed_channel(l, a, b, run.padded_count, out.v);
    } else {
      plain_channel(l, m.ambient_0[c], m.ambient_1[c], m.sun[c], run.padded_count, out.v);
    }
    if (l.highlights) add_highlight(l, frame.sun_specular[c], run.padded_count, out.v);
    if (factor != nullptr) multiply(factor, run.padded_count, out.v);
    std::copy_n(out.v, run.rays.count, run.out[c]);
  }
}

void set_highlights(const SceneFrame& frame, const SurfaceLight& m, const SurfaceLight& other,
                    const Lanes& facing, const SceneRun& run, RunLight& l) {
  const float sun[3] = {static_cast<float>(frame.sun_camera.x()), static_cast<float>(frame.sun_camera.y()),
                        static_cast<float>(frame.sun_camera.z())};
  if (!l.mixed) l.other.fill(0.0f, run.padded_count);
  highlight_run(run.rays, sun, m.roughness, l.mixed ? other.roughness : m.roughness, run.padded_count,
                facing.v, l.sunshine.v, l.other.v, l.highlight.v);
  l.highlights = true;
}

RIGOR_WIDE void sky_run(const RayRow& w, const float* up, int count, float* __restrict sine) {
  const float* __restrict us = w.u;
  const float* __restrict vs = w.v;
  for (int i = 0; i < count; ++i) {
    const float u = us[i], v = vs[i];
    sine[i] = (up[0] * u + up[1] * v + up[2]) / std::sqrt(u * u + v * v + 1.0f);
  }
}

}  // namespace

void SceneShades::sunlight(const SceneRun& run) const {
  std::fill_n(run.lit, run.padded_count, 1.0f);
  for (const Shade& s : shades_)
    (s.cylinder ? shade_cylinder : shade_box)(s.rays, run.rays, s.sun, run.padded_count, run.t, run.lit);
}

void light_of_sky(const SceneFrame& frame, const SceneRun& run) {
  Lanes sine;
  const float up[3] = {static_cast<float>(frame.up_camera.x()), static_cast<float>(frame.up_camera.y()),
                       static_cast<float>(frame.up_camera.z())};
  std::fill_n(run.lit, run.padded_count, 0.0f);
  sky_run(run.rays, up, run.padded_count, sine.v);
  for (std::size_t c = 0; c < static_cast<std::size_t>(run.channels); ++c)
    for (int i = 0; i < run.rays.count; ++i)
      run.out[c][i] = sine.v[i] > 0.0f ? frame.sky_horizon[c] + frame.sky_gradient[c] * sine.v[i]
                                       : frame.below_horizon[c];
}

void light_of_ground(const SceneFrame& frame, const SceneShades& shades, const SceneRun& run) {
  const FrameGround& g = frame.ground;
  const int n = run.padded_count;
  RunLight l;
  PlaneHit hit;
  hit_plane(g.rays, run.rays, 1.0f, 1.0f, n, run.t, hit);
  l.mixed = g.material != g.other;
  if (l.mixed) checker_run(hit, n, l.other.v);
  l.up.fill(1.0f, n);
  if (frame.sun_up && g.cos_sun > 0) {
    shades.sunlight(run);
    for (int i = 0; i < n; ++i) l.sunshine.v[i] = run.lit[i] * g.cos_sun;
    if (std::min(g.material->roughness, g.other->roughness) < 1.0f) {
      Lanes facing;
      // The frame's z axis is in metres, so that its component of a ray is the normal's.
      facing_plane(g.rays, run.rays, 2, 1.0f, n, facing.v);
      set_highlights(frame, *g.material, *g.other, facing, run, l);
    }
  } else {
    std::fill_n(run.lit, n, 0.0f);
    l.sunshine.fill(0.0f, n);
  }
  Lanes factor;
  if (g.noise_contrast > 0)
    noise_run(hit, static_cast<std::uint32_t>(g.base_cell[0]) * kNoiseCellsPerCell,
              static_cast<std::uint32_t>(g.base_cell[1]) * kNoiseCellsPerCell, g.noise_contrast, n, factor.v);
  put(frame, l, *g.material, *g.other, g.noise_contrast > 0 ? factor.v : nullptr, run);
}

void light_of_body(const SceneFrame& frame, const FrameBody& body, int face, const SceneShades& shades,
                   const SceneRun& run) {
  const int n = run.padded_count;
  const FrameRays& rays = body.rays;
  const bool side = body.cylinder && face == 0;
  const int axis = face / 2;
  const float sign = face % 2 == 0 ? -1.0f : 1.0f;
  RunLight l;
  bool sun = frame.sun_up;
  if (side) {
    cosines_of_side(rays, run.rays, body.up.data(), n, run.t, l.up.v);
    cosines_of_side(rays, run.rays, body.sun.data(), n, run.t, l.sunshine.v);
    for (int i = 0; i < n; ++i) l.sunshine.v[i] = l.sunshine.v[i] > 0.0f ? l.sunshine.v[i] : 0.0f;
  } else {
    l.up.fill(sign * body.up[axis], n);
    const float cos_sun = sign * body.sun[axis];
    sun = sun && cos_sun > 0.0f;
    l.sunshine.fill(cos_sun, n);
  }
  l.mixed = body.dark != nullptr && face == 5;
  const SurfaceLight& other = l.mixed ? *body.dark : *body.material;
  if (l.mixed) {
    const Eigen::Vector2f scale = body.half_size_m.head<2>() * body.squares_per_m;
    PlaneHit hit;
    hit_plane(rays, run.rays, scale.x(), scale.y(), n, run.t, hit);
    board_run(hit, 0.5f * body.squares.x(), 0.5f * body.squares.y(), n, l.other.v);
  }
  if (!sun) {
    std::fill_n(run.lit, n, 0.0f);
    l.sunshine.fill(0.0f, n);
  } else {
    shades.sunlight(run);
    for (int i = 0; i < n; ++i) l.sunshine.v[i] *= run.lit[i];
    if (std::min(body.material->roughness, other.roughness) < 1.0f) {
      Lanes facing;
      if (side)
        facing_side(rays, run.rays, body.half_size_m.x(), body.half_size_m.y(), n, run.t, facing.v);
      else
        facing_plane(rays, run.rays, axis, sign * body.half_size_m[axis], n, facing.v);
      set_highlights(frame, *body.material, other, facing, run, l);
    }
  }
  put(frame, l, *body.material, other, nullptr, run);
}

}  // namespace rigor::render
