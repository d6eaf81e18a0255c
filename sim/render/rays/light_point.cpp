#include "sim/render/rays/light_point.h"

#include <cmath>

namespace rigor::render::light {
namespace {

/// Finer than any map.
constexpr float kFinest = -100;
/// Cosine below which a ray's width across a surface is not told apart.
constexpr float kGrazing = 0.02F;

}  // namespace

PointLookup::PointLookup(const RayScene& scene, const LightSurfaces& surfaces, const LightFrame& frame,
                         const std::array<int, 4>& bands)
    : scene_(scene), surfaces_(surfaces), frame_(frame), tint_(tint_to_band(bands)) {}

void PointLookup::fetch_moving(Vec3 o, Vec3 d, const Intersection& m, Point& p, Bands4& tint,
                               const LightSurface*& surface, float uv[2]) const {
  const double origin[3] = {static_cast<double>(o.x), static_cast<double>(o.y), static_cast<double>(o.z)};
  const float direction[3] = {d.x, d.y, d.z};
  const SurfacePoint at = scene_.point(origin, direction, p.time, m);
  p.geometric_normal = from(at.triangle_normal);
  p.shading_normal = from(at.shading_normal);
  p.normal = from(at.normal);
  tint = tint_[0] * at.tint[0] + tint_[1] * at.tint[1] + tint_[2] * at.tint[2];
  surface = &surfaces_.of(at.surface->surface.get());
  uv[0] = at.uv[0];
  uv[1] = at.uv[1];
}

const PointLookup::Facet& PointLookup::facet(const Intersection& m) {
  Facet& f = facet_;
  if (f.instance == m.instance && f.part == m.part && f.triangle == m.triangle) return f;
  const RayInstance& instance = scene_.instance(m.instance);
  const RayMesh& mesh = *instance.mesh;
  const RayPart& part = mesh.parts[m.part];
  f.instance = m.instance;
  f.part = m.part;
  f.triangle = m.triangle;
  f.node = instance.node;
  f.moves = instance.motion != kStill;
  if (f.moves) return f;
  f.mirrored = instance.mirrored != 0;
  f.surface = &surfaces_.of(part.surface->surface.get());
  f.tint = tint_[0] * instance.tint[0] + tint_[1] * instance.tint[1] + tint_[2] * instance.tint[2];
  const auto corners = corners_of(instance, m);
  std::copy(corners.begin(), corners.end(), f.corner);
  const Vertex &a = *f.corner[0], &b = *f.corner[1], &c = *f.corner[2];
  float inverse[9];
  for (int k = 0; k < 9; ++k) inverse[k] = static_cast<float>(instance.inverse[k]);
  // Of normals: the transpose of the way from the world's axes to the mesh's.
  const auto to_world = [&](Vec3 n) {
    return Vec3{inverse[0] * n.x + inverse[3] * n.y + inverse[6] * n.z,
                inverse[1] * n.x + inverse[4] * n.y + inverse[7] * n.z,
                inverse[2] * n.x + inverse[5] * n.y + inverse[8] * n.z};
  };
  const Vec3 pa = from(a.position), e1 = from(b.position) - pa, e2 = from(c.position) - pa;
  f.plane = to_world(cross(e1, e2));
  for (int k = 0; k < 3; ++k) f.normal[k] = to_world(from(f.corner[k]->normal));
  f.one_normal = f.normal[0] == f.normal[1] && f.normal[0] == f.normal[2];
  if (!f.surface->any_map) return f;
  const float du1 = b.uv[0] - a.uv[0], du2 = c.uv[0] - a.uv[0], dv1 = b.uv[1] - a.uv[1],
              dv2 = c.uv[1] - a.uv[1];
  const float shrinks = std::abs(inverse[0] * (inverse[4] * inverse[8] - inverse[5] * inverse[7]) -
                                 inverse[1] * (inverse[3] * inverse[8] - inverse[5] * inverse[6]) +
                                 inverse[2] * (inverse[3] * inverse[7] - inverse[4] * inverse[6]));
  f.maps_per_m2 = std::abs(du1 * dv2 - du2 * dv1) * shrinks / std::max(length(f.plane), 1e-20F);
  if (f.surface->normal == nullptr) return f;
  // Gradients of u and v on the triangle (Mikkelsen 2010), both times the same number above 0.
  const Vec3 in_mesh = unit(cross(e1, e2), {0, 0, 1});
  const Vec3 u1 = cross(e2, in_mesh), u2 = cross(in_mesh, e1);
  f.right = to_world(u1 * du1 + u2 * du2);
  f.down = to_world(u1 * dv1 + u2 * dv2);
  return f;
}

void PointLookup::fetch(Vec3 origin, Vec3 d, float time, const Intersection& m, float spread_rad, Point& p) {
  const Facet& f = facet(m);
  p.range_m = m.range_m;
  p.met = m;
  p.place = origin + d * m.range_m;
  p.view = -d;
  p.time = time;
  p.node = f.node;
  const LightSurface* surface = f.surface;
  Bands4 tint = f.tint;
  float uv[2], lod = kFinest;
  if (f.moves) {
    fetch_moving(origin, d, m, p, tint, surface, uv);
  } else {
    const float u = m.u, v = m.v, w = 1.0F - u - v;
    for (int k = 0; k < 2; ++k)
      uv[k] = w * f.corner[0]->uv[k] + u * f.corner[1]->uv[k] + v * f.corner[2]->uv[k];
    p.geometric_normal = unit(f.plane, p.view);
    const bool behind = (dot(f.plane, d) > 0) != f.mirrored;
    if (dot(p.geometric_normal, d) > 0) p.geometric_normal = -p.geometric_normal;
    const Vec3 bent = f.one_normal ? f.normal[0] : f.normal[0] * w + f.normal[1] * u + f.normal[2] * v;
    p.shading_normal = unit(behind ? -bent : bent, p.geometric_normal);
    p.normal = p.shading_normal;
    if (surface->any_map) {
      if (spread_rad > 0) {
        // How wide the ray is across the triangle, in parts of the map.
        const float wide_m =
            spread_rad * m.range_m / std::max(std::abs(dot(p.geometric_normal, d)), kGrazing);
        lod = 0.5F * std::log2(std::max(f.maps_per_m2 * wide_m * wide_m, 1e-20F));
      }
      if (surface->normal != nullptr)
        p.normal = surface->normal_mapped(uv[0], uv[1], lod, f.right, f.down, p.shading_normal);
    }
  }
  p.patch = surface->patch(uv[0], uv[1], lod, tint);
  weather(frame_, p.place, p.normal, p.patch);
}

}  // namespace rigor::render::light
