// What the rays engine and the tracer of light share: the content as Embree's two levels (a structure of
// triangles per mesh, instances above them), shooting at it, and what lies at the point that was met.
// Internal to sim/render/rays.
//
//   auto& impl = engine.impl();
//   auto scene = impl.scene_at(query.origin);             // Result<const RayScene*>; serial
//   impl.arena().execute([&] { tbb::parallel_for(…        // chunks of at most kPacketRays rays
//     RayPackets rays;
//     rays.set(i, origin, direction, near, far, time);    // origin relative to scene.origin()
//     scene.intersect(rays, n, coherent);                 // first intersections
//     Intersection m = rays.intersection(i);
//     SurfacePoint p = scene.point(origin, direction, time, m);
//     PointOptics o = optics_at(*p.surface, p.uv, p.tint, p.normal, p.place, scene.weather(), bands, …);
//
// Everything const may be called from any number of threads at once.
#pragma once

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <span>
#include <tuple>
#include <vector>

#include "sim/render/engine/ray_engine.h"
#include "sim/render/rays/light_vec.h"
#include "sim/render/rays/ray_surface.h"

namespace rigor::render {

/// Bits of a ray's mask: an instance of what casts no shadow lacks the second.
constexpr unsigned kSeenMask = 1, kShadowMask = 2;

/// Where a triangle lies on a map with holes.
struct HoledTriangle {
  float uv[6];         ///< u, v of its three corners
  float texels_per_m;  ///< along the triangle, a metre of the mesh; square root of the ratio of areas
};
struct RayPart {
  std::shared_ptr<const RaySurface> surface;
  std::uint32_t first_index = 0, triangles = 0;
  std::vector<HoledTriangle> holed;  ///< of parts with holes alone
  bool one_sided = false;
};

/// A mesh as Embree has it. Shares vertices and indices with it.
struct RayMesh {
  RayMesh() = default;
  ~RayMesh();
  RayMesh(const RayMesh&) = delete;
  RayMesh& operator=(const RayMesh&) = delete;

  std::shared_ptr<const Mesh> mesh;
  std::vector<RayPart> parts;  ///< by Embree's geomID
  RTCScene scene = nullptr;    ///< null: nothing in it can be met
  std::uint32_t triangles = 0, left_out = 0;
  bool one_sided = false;  ///< some part shows one side alone
  bool holes = false;      ///< some part has holes
};

/// The first thing that a ray intersects.
struct Intersection {
  float range_m = std::numeric_limits<float>::infinity();  ///< Embree's
  float u = 0, v = 0;                                      ///< barycentric: (1 - u - v) a + u b + v c
  std::uint32_t instance = RTC_INVALID_GEOMETRY_ID;        ///< RayScene::instance() knows it
  std::uint32_t part = 0, triangle = 0;
  [[nodiscard]] bool nothing() const noexcept { return instance == RTC_INVALID_GEOMETRY_ID; }
};

/// Rays to be shot together: set them all, shoot, read.
constexpr unsigned kPacketRays = 256;
struct alignas(64) RayPackets {
  std::array<RTCRayHit8, kPacketRays / 8> packets;
  /// A ray that is not finite intersects nothing.
  void set(unsigned i, const float origin[3], const float direction[3], float near_m, float far_m, float time,
           unsigned mask = kSeenMask) noexcept;
  /// A place without a ray: intersects nothing.
  void skip(unsigned i) noexcept;
  [[nodiscard]] Intersection intersection(unsigned i) const noexcept;
};

inline void RayPackets::skip(unsigned i) noexcept {
  RTCRayHit8& p = packets[i / 8];
  const unsigned k = i % 8;
  p.ray.org_x[k] = p.ray.org_y[k] = p.ray.org_z[k] = 0;
  p.ray.dir_x[k] = p.ray.dir_y[k] = p.ray.dir_z[k] = 0;
  p.ray.time[k] = 0;
  p.ray.tnear[k] = 1;
  p.ray.tfar[k] = 0;
  p.ray.mask[k] = p.ray.id[k] = p.ray.flags[k] = 0;
  p.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
  p.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
}

inline void RayPackets::set(unsigned i, const float o[3], const float d[3], float near_m, float far_m,
                            float time, unsigned mask) noexcept {
  RTCRayHit8& p = packets[i / 8];
  const unsigned k = i % 8;
  // A sum is finite only where all of it is.
  const float sum = (o[0] + o[1] + o[2]) * 0.0F + (d[0] + d[1] + d[2]) * 0.0F + time * 0.0F;
  const bool there = sum == 0.0F && (d[0] != 0 || d[1] != 0 || d[2] != 0) && near_m <= far_m;
  if (!there) {
    skip(i);
    return;
  }
  p.ray.org_x[k] = o[0];
  p.ray.org_y[k] = o[1];
  p.ray.org_z[k] = o[2];
  p.ray.tnear[k] = std::max(near_m, 0.0F);
  p.ray.dir_x[k] = d[0];
  p.ray.dir_y[k] = d[1];
  p.ray.dir_z[k] = d[2];
  p.ray.time[k] = std::clamp(time, 0.0F, 1.0F);
  p.ray.tfar[k] = far_m;
  p.ray.mask[k] = mask;
  p.ray.id[k] = i;
  p.ray.flags[k] = 0;
  p.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
  p.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
}

constexpr std::uint32_t kStill = 0x7FFFFFFF;
/// An instance as it stands in the scene's cell.
struct RayInstance {
  double inverse[9]{};   ///< of rotation times scale, row by row: world axes to the mesh's
  double position[3]{};  ///< relative to its batch's origin
  const RayMesh* mesh = nullptr;
  NodeId node{};
  float tint[3]{1, 1, 1};
  std::uint32_t motion : 31 = kStill;  ///< index into its batch's motions; kStill: none
  std::uint32_t mirrored : 1 = 0;      ///< an odd number of scales is negative
};
static_assert(sizeof(RayInstance) == 128);

/// Corners of a triangle of an instance's mesh.
[[nodiscard]] inline std::array<const Vertex*, 3> corners_of(const RayInstance& instance,
                                                             const Intersection& m) noexcept {
  const Mesh& mesh = *instance.mesh->mesh;
  const std::uint32_t* const index =
      &mesh.indices[instance.mesh->parts[m.part].first_index + 3 * static_cast<std::size_t>(m.triangle)];
  return {&mesh.vertices[index[0]], &mesh.vertices[index[1]], &mesh.vertices[index[2]]};
}

/// Poses of an instance at equal steps over the window. Between them places and scales go linearly, rotations
/// by slerp, as Embree has it.
struct RayMotion {
  struct Pose {
    Eigen::Vector3d position;  ///< relative to the batch's origin at the first instant
    Eigen::Quaterniond rotation;
    Eigen::Vector3d scale;
  };
  std::vector<Pose> poses;
};

/// A batch as Embree has it: relative to its origin, whatever cell it is seen from.
struct RayBatch {
  RayBatch() = default;
  ~RayBatch();
  RayBatch(const RayBatch&) = delete;
  RayBatch& operator=(const RayBatch&) = delete;

  std::vector<std::uint64_t> serials;  ///< of the batch at each instant; one where it stands still
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< at the first instant, world frame
  std::vector<RayInstance> instances;                ///< in the batch's order; those left out have no mesh
  std::vector<RayMotion> motions;
  std::vector<const Mesh*> choice;                     ///< by instance, or one for all; null: none
  std::vector<std::shared_ptr<const RayMesh>> meshes;  ///< keeps them
  /// Small things in large numbers have a structure of their own, so that what changes elsewhere does not
  /// cost them. Null: its instances lie in the scene itself.
  RTCScene scene = nullptr;
  std::uint32_t present = 0, left_out = 0;  ///< instances
  bool casts_shadow = true;
};

/// What lies where a ray intersects a surface. World axes. The normals are those that the Vulkan engine's
/// shader has: outward, and of a two-sided surface met from behind turned round; bent ones may look away from
/// the ray.
struct SurfacePoint {
  double range_m = 0;          ///< along the ray, worked out in double
  float normal[3]{};           ///< with the normal map, unit length
  float shading_normal[3]{};   ///< of the vertices, unit length
  float triangle_normal[3]{};  ///< of the triangle's plane, unit length, on the side that was met
  float uv[2]{};
  float place[3]{};  ///< relative to the scene's cell
  float tint[3]{1, 1, 1};
  const RaySurface* surface = nullptr;
  NodeId node{};
};

/// Rays that are as wide as what they carry light to: squares.
struct WideRays {
  const float* half_width_m;  ///< where a ray starts, by its number in the packets
  float half_width_per_m;     ///< what it grows by along the ray
};
/// A ray that lets less through than this, in one walk, lets nothing through: in thick foliage rays end
/// early.
inline constexpr float kLeastClear = 0.05F;

/// What a walk of wide rays counts.
struct WideWalk {
  /// Of -log2 of the share that gets through. Whole numbers: the order in which leaves are met does not
  /// count.
  static constexpr float kUnitsAHalving = 65536;
  const WideRays& rays;
  std::uint32_t most;  ///< a ray's walk ends above it
  /// Backs of surfaces with one side are not there, as for rays of an eye.
  bool fronts_alone = false;
  std::array<std::uint32_t, kPacketRays> cover{};  ///< of each ray
  [[nodiscard]] float clear(unsigned ray) const noexcept {
    return std::exp2(static_cast<float>(cover[ray]) / -kUnitsAHalving);
  }
};

/// What wide rays meet of surfaces with holes, nearest first: which are told does not depend on the order in
/// which they are met.
struct LayerWalk {
  static constexpr unsigned kMost = LayeredHits::kMost;
  /// A ray of which less is left ends at the surface that leaves it: what is behind counts as part of that.
  static constexpr float kLeast = 0.2F;
  struct Layer {
    Intersection met;
    float cover = 0;  ///< of the ray
  };
  explicit LayerWalk(const WideRays& r) : rays(r) {}
  const WideRays& rays;
  std::array<std::uint8_t, kPacketRays> count{};
  std::array<std::array<Layer, kMost>, kPacketRays> layers;
  /// Surfaces of a ray in the order in which it meets them; those at one range by their numbers.
  [[nodiscard]] static auto key(const Intersection& m) noexcept {
    return std::tuple(m.range_m, m.instance, m.part, m.triangle);
  }
  /// Takes a surface that covers so much of a ray. False where the ray ends there, or before.
  bool add(unsigned ray, const Layer& layer) noexcept;
};

class RayScene;
struct RayProfile;
/// What a walk through a scene carries along. Embree hands back the address of `embree`.
struct SceneContext {
  RTCIntersectContext embree;
  const RayScene* scene = nullptr;
  WideWalk* wide = nullptr;     ///< null: shadow rays have no width
  LayerWalk* layers = nullptr;  ///< null: rays end at the first leaf
  std::uint32_t base =
      0;  ///< where the numbers of the level, or of the batch with a structure of its own, begin
};

/// The content of a window round a cell of the world.
class RayScene {
 public:
  virtual ~RayScene() = default;
  RayScene(const RayScene&) = delete;
  RayScene& operator=(const RayScene&) = delete;

  /// Middle of the cell, world frame.
  [[nodiscard]] const Eigen::Vector3d& origin() const noexcept { return origin_; }
  /// Of Intersection::instance.
  [[nodiscard]] const RayInstance& instance(std::uint32_t id) const noexcept {
    const Owner o = owner(id);
    return o.batch->batch->instances[o.index];
  }
  [[nodiscard]] const RayWeather& weather() const noexcept { return weather_; }
  /// What times the walks; null: nothing.
  void set_profile(RayProfile* profile) noexcept { profile_ = profile; }

  /// What of the content rays ask.
  enum class Part : std::uint8_t { all, still, moving };
  /// Shoots the first n. Back faces of what is one-sided are not there, as in the Vulkan engine; holes are
  /// holes. `coherent`: neighbours may go much the same way (a matter of speed alone).
  void intersect(RayPackets& rays, unsigned n, bool coherent, Part part = Part::all) const noexcept {
    intersect(rays, n, coherent, part, nullptr);
  }
  /// As above; surfaces with holes of which a ray meets a part are in `walk`. Directions are of unit length.
  void intersect(RayPackets& rays, unsigned n, bool coherent, LayerWalk& walk) const noexcept {
    intersect(rays, n, coherent, Part::all, &walk);
  }
  /// hidden[i] = 1 where anything stands between near and far: a face hides from both its sides, holes do
  /// not.
  void occluded(RayPackets& rays, unsigned n, bool coherent, std::uint8_t* hidden,
                Part part = Part::all) const noexcept;
  /// As above, but backs of one-sided surfaces are not there, as for intersect().
  void occluded_by_fronts(RayPackets& rays, unsigned n, std::uint8_t* hidden, Part part) const noexcept;
  /// clear[i]: the share of its light that a ray lets through between near and far. Nothing where a surface
  /// without holes stands, else the product of the shares that surfaces with holes leave free over the ray's
  /// width. Directions are of unit length. A ray that meets the common edge of two triangles counts both.
  void clear_share(RayPackets& rays, unsigned n, bool coherent, const WideRays& wide, float* clear,
                   Part part = Part::all) const noexcept;
  /// As above, past what stands still, each ray in a walk of its own, so that its answer does not depend on
  /// the others to the last bit; it takes between two and three times as long as a ray among its neighbours.
  /// leaves[i]: whether surfaces with holes decide: they cover a part of a ray that nothing else stops, or
  /// all of it.
  void clear_share_alone(RayPackets& rays, unsigned n, const WideRays& wide, float* clear,
                         std::uint8_t* leaves) const noexcept;
  /// Like clear_share(), but backs of one-sided surfaces are not there, as for intersect().
  void sky_share(RayPackets& rays, unsigned n, const WideRays& wide, float* clear) const noexcept;
  /// Whether hit i of what a filter is asked is of a face that looks away from its ray.
  [[nodiscard]] static bool looks_away(const SceneContext& context, const RTCFilterFunctionNArguments* a,
                                       unsigned i) noexcept;
  [[nodiscard]] bool anything_moves() const noexcept { return !moving_.batches.empty(); }
  /// Something that stands still casts a shadow with holes in it.
  [[nodiscard]] bool holes_shade() const noexcept { return still_.holes_shade; }
  /// Has what point() will read on its way from memory.
  void fetch(const RayPackets& rays, unsigned n) const noexcept;
  /// What was met. `origin` relative to origin().
  [[nodiscard]] SurfacePoint point(const double origin[3], const float direction[3], float time,
                                   const Intersection& m) const noexcept;

  /// From the world's axes to a mesh's: p_mesh = inverse · (p - position).
  struct Placement {
    Eigen::Matrix3d inverse;
    Eigen::Vector3d position;
  };
  [[nodiscard]] Placement placement(std::uint32_t id, float time) const noexcept;
  /// A triangle in the world's axes: u and v of an intersection lie at corner + u e1 + v e2.
  struct Triangle {
    light::Vec3 corner, e1, e2;  ///< corner: relative to origin()
  };
  /// Of an intersection with what stands still.
  [[nodiscard]] Triangle triangle(const Intersection& m) const noexcept;
  /// Whether an instance is among what moves.
  [[nodiscard]] bool moves(std::uint32_t id) const noexcept { return id >= moving_.first; }
  /// Another one in the whole process whenever what stands still, or how it is numbered, may be another.
  [[nodiscard]] std::uint64_t still_serial() const noexcept { return still_serial_; }

 protected:
  /// A batch in the scene.
  struct Placed {
    std::shared_ptr<const RayBatch> batch;
    Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< of its origin from the cell
    float shift[3]{};                                  ///< the same
    /// Where the numbers of its instances begin in its level: below Level::top as Embree has them, above that
    /// those of batches with a structure of their own, from a multiple of kBlock on.
    std::uint32_t base = 0;
    std::uint32_t first = 0, room = 0;    ///< of Embree's geometries in the scene
    std::vector<RTCGeometry> geometries;  ///< null: left out
  };
  static constexpr std::uint32_t kBlock = 64;
  /// What stands still and what moves are scenes of their own, so that what moves costs no more than itself.
  struct Level {
    RTCScene handle = nullptr;
    std::uint32_t first = 0;  ///< of its instances among those of both levels
    std::uint32_t top = 0;
    bool holes_shade = false;                      ///< something with holes casts a shadow
    std::vector<std::unique_ptr<Placed>> batches;  ///< in the order of the content
    std::vector<const Placed*> of_top, of_block;
    [[nodiscard]] std::uint32_t end() const noexcept {
      return first + top + static_cast<std::uint32_t>(of_block.size()) * kBlock;
    }
  };
  struct Owner {
    const Placed* batch;
    std::uint32_t index;
  };
  [[nodiscard]] Owner owner(std::uint32_t id) const noexcept {
    const Level& l = id < moving_.first ? still_ : moving_;
    id -= l.first;
    const Placed& p = *(id < l.top ? l.of_top[id] : l.of_block[(id - l.top) / kBlock]);
    return {&p, id - p.base};
  }
  void intersect(RayPackets& rays, unsigned n, bool coherent, Part part, LayerWalk* walk) const noexcept;
  void shoot(const int* valid, bool coherent, RTCRayHit8& packet, SceneContext& context,
             Part part) const noexcept;
  [[nodiscard]] static Placement placement(const Owner& o, float time) noexcept;
  void occluded(RayPackets& rays, unsigned n, bool coherent, std::uint8_t* hidden, Part part,
                SceneContext& context) const noexcept;
  void clear_share(RayPackets& rays, unsigned n, bool coherent, WideWalk& walk, float* clear,
                   Part part) const noexcept;
  friend struct SceneFilters;

  RayScene() = default;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();
  Level still_, moving_;
  std::uint64_t still_serial_ = 0;
  RayWeather weather_;
  RayProfile* profile_ = nullptr;
};

}  // namespace rigor::render
