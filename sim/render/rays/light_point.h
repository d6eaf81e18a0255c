// Points on surfaces that rays have met, as light asks for them: where they are, which way they face, what
// they are made of. Internal to sim/render/rays.
#pragma once

#include <array>
#include <cmath>

#include "sim/render/rays/embree_scene.h"
#include "sim/render/rays/light_shading.h"
#include "sim/render/rays/light_surface.h"

namespace rigor::render::light {

/// Places relative to the scene's cell.
struct Point {
  Vec3 place, view, normal, shading_normal;
  Vec3 geometric_normal;  ///< of the triangle, towards the ray's origin
  float range_m = 0, time = 0;
  unsigned ray = 0;  ///< whose it is: the caller's
  NodeId node{};
  Intersection met;  ///< the triangle, and where on it
  MaterialSample patch{};
  Bands4 light{};  ///< the caller's
};

/// Off a surface by more than places and intersections are rounded, to the side where `towards` leads.
[[nodiscard]] inline Vec3 off_surface(Vec3 place, Vec3 geometric_normal, Vec3 towards) {
  const float rounding =
      2e-4F + 3e-6F * std::max(std::abs(place.x), std::max(std::abs(place.y), std::abs(place.z)));
  return place + geometric_normal * std::copysign(rounding, dot(geometric_normal, towards));
}

/// Belongs to one thread.
class PointLookup {
 public:
  PointLookup(const RayScene& scene, const LightSurfaces& surfaces, const LightFrame& frame,
              const std::array<int, 4>& bands);
  /// All of a point but its ray and light. `spread_rad`: angle that the ray stands for.
  void fetch(Vec3 origin, Vec3 direction, float time, const Intersection& m, float spread_rad, Point& p);

 private:
  /// What the points of a triangle share.
  struct Facet {
    std::uint32_t instance = RTC_INVALID_GEOMETRY_ID, part = 0, triangle = 0;  ///< of Intersection
    NodeId node{};
    bool moves = false, mirrored = false;  ///< what moves has no more than this and its node
    bool one_normal = false;               ///< the corners' are the same
    const LightSurface* surface = nullptr;
    Bands4 tint{};
    const Vertex* corner[3]{};
    // World axes, none of unit length.
    Vec3 plane;             ///< square to the triangle
    Vec3 normal[3];         ///< of the corners
    Vec3 right, down;       ///< gradients of u and v, where there is a normal map
    float maps_per_m2 = 0;  ///< area of the map, in whole maps, per m² of the triangle
  };

  /// Of the triangle that was met: the last one is kept.
  const Facet& facet(const Intersection& m);
  void fetch_moving(Vec3 origin, Vec3 direction, const Intersection& m, Point& p, Bands4& tint,
                    const LightSurface*& surface, float uv[2]) const;

  const RayScene& scene_;
  const LightSurfaces& surfaces_;
  const LightFrame& frame_;
  const std::array<Bands4, 3> tint_;  ///< to bands
  Facet facet_;
};

}  // namespace rigor::render::light
