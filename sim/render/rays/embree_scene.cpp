#include "sim/render/rays/embree_scene.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "rt-core/stage_time.h"
#include "sim/render/rays/embree_engine.h"

namespace rigor::render {
namespace {

/// Adds the CPU time that it lived.
class WalkTime {
 public:
  explicit WalkTime(RayProfile* profile) noexcept : profile_(profile) {
    if (profile_) begun_ = StageTime::thread_cpu();
  }
  ~WalkTime() {
    if (profile_) profile_->walk_ns += (StageTime::thread_cpu() - begun_).ns();
  }
  WalkTime(const WalkTime&) = delete;
  WalkTime& operator=(const WalkTime&) = delete;

 private:
  RayProfile* profile_;
  Duration begun_;
};

constexpr float kNarrow = 0.998F;  // 3.6 degrees

/// Against the ray, of the plane of the triangle, both in the mesh's axes.
bool is_back(const RayInstance& i, double along) noexcept { return (along > 0) != (i.mirrored != 0); }

/// Which lanes of a packet have a ray.
bool lanes(const RTCRay8& r, unsigned first, unsigned n, int* valid) noexcept {
  bool any = false;
  for (unsigned k = 0; k < 8; ++k) {
    const bool there = first + k < n && r.tnear[k] <= r.tfar[k];
    valid[k] = there ? -1 : 0;
    any = any || there;
  }
  return any;
}

Eigen::Matrix3d inverse_of(const Eigen::Quaterniond& rotation, const Eigen::Vector3d& scale) {
  return scale.cwiseInverse().asDiagonal() * rotation.toRotationMatrix().transpose();
}

/// How the rays of a packet go. A walk of all as one frustum pays where they stay within a few degrees.
/// Embree 3.13 loses rays in it where some lie in a plane of the axes and others beside it: these walk as
/// eight. Rays that go apart are faster one by one.
enum class Going : std::uint8_t { together, alike, apart };
Going going(const RTCRay8& r, const int* valid) noexcept {
  int first = -1, others = 0;
  Going how = Going::together;
  for (int k = 0; k < 8; ++k) {
    if (valid[k] == 0) continue;
    if (first < 0)
      first = k;
    else
      ++others;
    if (r.dir_x[k] * r.dir_x[first] + r.dir_y[k] * r.dir_y[first] + r.dir_z[k] * r.dir_z[first] < kNarrow)
      return Going::apart;
    for (const float* d : {r.dir_x, r.dir_y, r.dir_z})
      if ((d[k] > 0) != (d[first] > 0) || (d[k] < 0) != (d[first] < 0)) how = Going::alike;
  }
  return others > 0 ? how : Going::apart;
}
WideWalk wide_walk(const WideRays& rays) noexcept {
  return {rays, static_cast<std::uint32_t>(-std::log2(kLeastClear) * WideWalk::kUnitsAHalving)};
}

RTCIntersectContextFlags flags(Going how) noexcept {
  return how == Going::together ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
}

// In what stands still walks of eight and of one find the same, to the last bit; in what moves they do not,
// so that walks through that are always of eight: what a ray meets must not depend on its neighbours.

RTCRay lane(const RTCRay8& r, unsigned k) noexcept {
  RTCRay one;
  one.org_x = r.org_x[k], one.org_y = r.org_y[k], one.org_z = r.org_z[k];
  one.tnear = r.tnear[k];
  one.dir_x = r.dir_x[k], one.dir_y = r.dir_y[k], one.dir_z = r.dir_z[k];
  one.time = r.time[k];
  one.tfar = r.tfar[k];
  one.mask = r.mask[k], one.id = r.id[k], one.flags = r.flags[k];
  return one;
}

void intersect_one(RTCScene scene, RTCIntersectContext& context, RTCRayHit8& p, unsigned k) noexcept {
  RTCRayHit one;
  one.ray = lane(p.ray, k);
  one.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  one.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(scene, &context, &one);
  if (one.hit.geomID == RTC_INVALID_GEOMETRY_ID) return;
  p.ray.tfar[k] = one.ray.tfar;
  p.hit.Ng_x[k] = one.hit.Ng_x, p.hit.Ng_y[k] = one.hit.Ng_y, p.hit.Ng_z[k] = one.hit.Ng_z;
  p.hit.u[k] = one.hit.u, p.hit.v[k] = one.hit.v;
  p.hit.primID[k] = one.hit.primID;
  p.hit.geomID[k] = one.hit.geomID;
  p.hit.instID[0][k] = one.hit.instID[0];
}

void occluded_one(RTCScene scene, RTCIntersectContext& context, RTCRay8& r, unsigned k) noexcept {
  RTCRay one = lane(r, k);
  rtcOccluded1(scene, &context, &one);
  r.tfar[k] = one.tfar;
}

void intersect_still(RTCScene scene, RTCIntersectContext& context, const int* valid, Going how,
                     RTCRayHit8& p) noexcept {
  if (how != Going::apart) {
    rtcIntersect8(valid, scene, &context, &p);
    return;
  }
  for (unsigned k = 0; k < 8; ++k)
    if (valid[k] != 0) intersect_one(scene, context, p, k);
}

void occluded_still(RTCScene scene, RTCIntersectContext& context, const int* valid, Going how,
                    RTCRay8& r) noexcept {
  if (how != Going::apart) {
    rtcOccluded8(valid, scene, &context, &r);
    return;
  }
  for (unsigned k = 0; k < 8; ++k)
    if (valid[k] != 0) occluded_one(scene, context, r, k);
}

}  // namespace

RayBatch::~RayBatch() {
  if (scene != nullptr) rtcReleaseScene(scene);
}

/// What Embree calls while it walks through a scene.
struct SceneFilters {
  static void leave_out_backs(const RTCFilterFunctionNArguments* a) {
    if (!static_cast<const RayPart*>(a->geometryUserPtr)->one_sided) return;
    const auto& context = *reinterpret_cast<const SceneContext*>(a->context);
    for (unsigned i = 0; i < a->N; ++i)
      if (a->valid[i] == -1 && RayScene::looks_away(context, a, i)) a->valid[i] = 0;
  }
  static void leave_out_what_has_no_holes(const RTCFilterFunctionNArguments* a) {
    if (static_cast<const RayPart*>(a->geometryUserPtr)->surface->holes) return;
    std::fill_n(a->valid, a->N, 0);
  }
};

bool RayScene::looks_away(const SceneContext& context, const RTCFilterFunctionNArguments* a,
                          unsigned i) noexcept {
  const unsigned n = a->N;
  const float along = RTCHitN_Ng_x(a->hit, n, i) * RTCRayN_dir_x(a->ray, n, i) +
                      RTCHitN_Ng_y(a->hit, n, i) * RTCRayN_dir_y(a->ray, n, i) +
                      RTCHitN_Ng_z(a->hit, n, i) * RTCRayN_dir_z(a->ray, n, i);
  return is_back(context.scene->instance(context.base + a->context->instID[0]), static_cast<double>(along));
}

Intersection RayPackets::intersection(unsigned i) const noexcept {
  const RTCRayHit8& p = packets[i / 8];
  const unsigned k = i % 8;
  Intersection m;
  if (p.hit.geomID[k] == RTC_INVALID_GEOMETRY_ID) return m;
  m.range_m = p.ray.tfar[k];
  m.u = p.hit.u[k];
  m.v = p.hit.v[k];
  m.instance = p.hit.instID[0][k];
  m.part = p.hit.geomID[k];
  m.triangle = p.hit.primID[k];
  return m;
}

bool LayerWalk::add(unsigned ray, const Layer& layer) noexcept {
  auto& own = layers[ray];
  unsigned at = 0;
  float left = 1;
  for (; at < count[ray] && key(own[at].met) < key(layer.met); ++at) left *= 1 - own[at].cover;
  left *= 1 - layer.cover;
  if (at == kMost || left < kLeast) return false;
  // Embree may ask for one triangle twice.
  if (at < count[ray] && key(own[at].met) == key(layer.met)) return true;
  if (count[ray] < kMost) ++count[ray];
  std::move_backward(own.begin() + at, own.begin() + count[ray] - 1, own.begin() + count[ray]);
  own[at] = layer;
  return true;
}

void RayScene::shoot(const int* valid, bool coherent, RTCRayHit8& p, SceneContext& context,
                     Part part) const noexcept {
  const Going how = coherent ? going(p.ray, valid) : Going::apart;
  context.embree.flags = flags(how);
  if (part != Part::moving) intersect_still(still_.handle, context.embree, valid, how, p);
  if (part == Part::still || moving_.batches.empty()) return;
  alignas(32) unsigned before[8];
  std::memcpy(before, p.hit.instID[0], sizeof before);
  std::fill_n(p.hit.instID[0], 8, RTC_INVALID_GEOMETRY_ID);
  context.base = moving_.first;
  rtcIntersect8(valid, moving_.handle, &context.embree, &p);
  context.base = 0;
  for (int k = 0; k < 8; ++k) {
    unsigned& id = p.hit.instID[0][k];
    id = id == RTC_INVALID_GEOMETRY_ID ? before[k] : moving_.first + id;
  }
}

void RayScene::intersect(RayPackets& rays, unsigned n, bool coherent, Part part,
                         LayerWalk* walk) const noexcept {
  const WalkTime time(profile_);
  SceneContext context;
  rtcInitIntersectContext(&context.embree);
  context.scene = this;
  context.layers = walk;
  alignas(32) int valid[8];
  for (unsigned first = 0; first < n; first += 8) {
    RTCRayHit8& p = rays.packets[first / 8];
    if (!lanes(p.ray, first, n, valid)) continue;
    float far_m[8];
    std::memcpy(far_m, p.ray.tfar, sizeof far_m);
    shoot(valid, coherent, p, context, part);
    // What was met from behind and has one side is not there: shot once more, past all such faces. Rare
    // enough (a sensor inside a hull) that the first shot need not ask at every face.
    bool again = false;
    for (unsigned k = 0; k < 8; ++k) {
      const bool met = valid[k] != 0 && p.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID;
      valid[k] = 0;
      if (!met) continue;
      const std::uint32_t id = p.hit.instID[0][k];
      const RayInstance& i = instance(id);
      if (!i.mesh->one_sided || !i.mesh->parts[p.hit.geomID[k]].one_sided) continue;
      const Eigen::Vector3d d(p.ray.dir_x[k], p.ray.dir_y[k], p.ray.dir_z[k]);
      const Eigen::Vector3d ng(p.hit.Ng_x[k], p.hit.Ng_y[k], p.hit.Ng_z[k]);
      double along = 0;
      if (i.motion == kStill) {
        const double* const m = i.inverse;
        along = ng.x() * (m[0] * d.x() + m[1] * d.y() + m[2] * d.z()) +
                ng.y() * (m[3] * d.x() + m[4] * d.y() + m[5] * d.z()) +
                ng.z() * (m[6] * d.x() + m[7] * d.y() + m[8] * d.z());
      } else {
        along = ng.dot(placement(id, p.ray.time[k]).inverse * d);
      }
      if (!is_back(i, along)) continue;
      valid[k] = -1;
      again = true;
      if (walk != nullptr) walk->count[first + k] = 0;
      p.ray.tfar[k] = far_m[k];
      p.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
      p.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
    }
    if (!again) continue;
    context.embree.filter = SceneFilters::leave_out_backs;
    shoot(valid, coherent, p, context, part);
    context.embree.filter = nullptr;
  }
}

void RayScene::occluded(RayPackets& rays, unsigned n, bool coherent, std::uint8_t* hidden,
                        Part part) const noexcept {
  const WalkTime time(profile_);
  SceneContext context;
  rtcInitIntersectContext(&context.embree);
  context.scene = this;
  occluded(rays, n, coherent, hidden, part, context);
}

void RayScene::occluded_by_fronts(RayPackets& rays, unsigned n, std::uint8_t* hidden,
                                  Part part) const noexcept {
  const WalkTime time(profile_);
  SceneContext context;
  rtcInitIntersectContext(&context.embree);
  context.embree.filter = SceneFilters::leave_out_backs;
  context.scene = this;
  occluded(rays, n, false, hidden, part, context);
}

void RayScene::clear_share(RayPackets& rays, unsigned n, bool coherent, const WideRays& wide, float* clear,
                           Part part) const noexcept {
  WideWalk walk = wide_walk(wide);
  clear_share(rays, n, coherent, walk, clear, part);
}

void RayScene::sky_share(RayPackets& rays, unsigned n, const WideRays& wide, float* clear) const noexcept {
  WideWalk walk = wide_walk(wide);
  walk.fronts_alone = true;
  clear_share(rays, n, true, walk, clear, Part::all);
}

void RayScene::clear_share(RayPackets& rays, unsigned n, bool coherent, WideWalk& walk, float* clear,
                           Part part) const noexcept {
  const WalkTime time(profile_);
  SceneContext context;
  rtcInitIntersectContext(&context.embree);
  if (walk.fronts_alone) context.embree.filter = SceneFilters::leave_out_backs;
  context.scene = this;
  context.wide = &walk;
  std::array<std::uint8_t, kPacketRays> hidden;
  occluded(rays, n, coherent, hidden.data(), part, context);
  for (unsigned i = 0; i < n; ++i) clear[i] = hidden[i] != 0 ? 0 : walk.clear(i);
}

void RayScene::clear_share_alone(RayPackets& rays, unsigned n, const WideRays& wide, float* clear,
                                 std::uint8_t* leaves) const noexcept {
  const WalkTime time(profile_);
  WideWalk walk = wide_walk(wide);
  SceneContext context;
  rtcInitIntersectContext(&context.embree);
  context.scene = this;
  context.wide = &walk;
  for (unsigned i = 0; i < n; ++i) {
    RTCRay8& r = rays.packets[i / 8].ray;
    const unsigned k = i % 8;
    clear[i] = 0;
    leaves[i] = 0;
    if (!(r.tnear[k] <= r.tfar[k])) continue;
    const float far_m = r.tfar[k];
    const auto hidden = [&] {
      r.tfar[k] = far_m;
      walk.cover[i] = 0;
      occluded_one(still_.handle, context.embree, r, k);
      return r.tfar[k] < 0;
    };
    if (!hidden()) {
      clear[i] = walk.clear(i);
      leaves[i] = walk.cover[i] > 0 ? 1 : 0;
      continue;
    }
    // Which of the two ends a walk first says nothing: leaves have to hide the ray without anything else.
    if (walk.cover[i] <= walk.most) {
      context.embree.filter = SceneFilters::leave_out_what_has_no_holes;
      hidden();
      context.embree.filter = nullptr;
    }
    leaves[i] = walk.cover[i] > walk.most ? 1 : 0;
  }
}

void RayScene::occluded(RayPackets& rays, unsigned n, bool coherent, std::uint8_t* hidden, Part part,
                        SceneContext& context) const noexcept {
  alignas(32) int valid[8];
  for (unsigned first = 0; first < n; first += 8) {
    RTCRay8& r = rays.packets[first / 8].ray;
    const unsigned count = std::min(8U, n - first);
    std::memset(hidden + first, 0, count);
    if (!lanes(r, first, n, valid)) continue;
    const Going how = coherent ? going(r, valid) : Going::apart;
    const auto note = [&] {
      for (unsigned k = 0; k < count; ++k)
        if (valid[k] != 0 && r.tfar[k] < 0) {
          hidden[first + k] = 1;
          valid[k] = 0;
        }
    };
    if (part != Part::moving) {
      context.base = still_.first;
      context.embree.flags = flags(how);
      occluded_still(still_.handle, context.embree, valid, how, r);
      note();
    }
    if (part != Part::still && !moving_.batches.empty()) {
      context.base = moving_.first;
      // Embree's walk of rays together may ask one triangle twice where, in the axes of a mesh that moves,
      // rays of different times lie in different octants.
      context.embree.flags = flags(context.wide == nullptr ? how : Going::apart);
      rtcOccluded8(valid, moving_.handle, &context.embree, &r);
      note();
    }
  }
}

RayScene::Placement RayScene::placement(std::uint32_t id, float time) const noexcept {
  return placement(owner(id), time);
}

RayScene::Placement RayScene::placement(const Owner& o, float time) noexcept {
  using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  const RayInstance& i = o.batch->batch->instances[o.index];
  const Eigen::Vector3d& offset = o.batch->offset;
  if (i.motion == kStill)
    return {Eigen::Map<const RowMajor>(i.inverse), offset + Eigen::Map<const Eigen::Vector3d>(i.position)};
  const auto& poses = o.batch->batch->motions[i.motion].poses;
  const double at = std::clamp(static_cast<double>(time), 0.0, 1.0) * static_cast<double>(poses.size() - 1);
  const std::size_t k = std::min(static_cast<std::size_t>(at), poses.size() - 2);
  const double f = at - static_cast<double>(k);
  const RayMotion::Pose &a = poses[k], &b = poses[k + 1];
  return {inverse_of(a.rotation.slerp(f, b.rotation), a.scale + f * (b.scale - a.scale)),
          offset + a.position + f * (b.position - a.position)};
}

RayScene::Triangle RayScene::triangle(const Intersection& m) const noexcept {
  using light::Vec3;
  const Owner o = owner(m.instance);
  const RayInstance& i = o.batch->batch->instances[o.index];
  const auto corner = corners_of(i, m);
  const Vec3 a = light::from(corner[0]->position), b = light::from(corner[1]->position),
             c = light::from(corner[2]->position);
  // The inverse of scale^-1 · rotation^T, whose rows are square to each other: each column is one of its rows
  // over the square of its length.
  Vec3 column[3];
  for (int k = 0; k < 3; ++k) {
    const double* const r = &i.inverse[3 * k];
    const double per = 1 / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
    column[k] = {static_cast<float>(r[0] * per), static_cast<float>(r[1] * per),
                 static_cast<float>(r[2] * per)};
  }
  const auto to_world = [&](Vec3 v) { return column[0] * v.x + column[1] * v.y + column[2] * v.z; };
  const Eigen::Vector3d& offset = o.batch->offset;
  const Vec3 place{static_cast<float>(offset.x() + i.position[0]),
                   static_cast<float>(offset.y() + i.position[1]),
                   static_cast<float>(offset.z() + i.position[2])};
  return {place + to_world(a), to_world(b - a), to_world(c - a)};
}

void RayScene::fetch(const RayPackets& rays, unsigned n) const noexcept {
  const RayInstance* instances[kPacketRays];
  const std::uint32_t* corners[kPacketRays];
  for (unsigned i = 0; i < n; ++i) {
    const RTCRayHit8& p = rays.packets[i / 8];
    const std::uint32_t id = p.hit.instID[0][i % 8];
    instances[i] = id == RTC_INVALID_GEOMETRY_ID ? nullptr : &instance(id);
    if (instances[i] == nullptr) continue;
    __builtin_prefetch(instances[i]);
    __builtin_prefetch(reinterpret_cast<const char*>(instances[i]) + 96);
  }
  for (unsigned i = 0; i < n; ++i) {
    if (instances[i] == nullptr) continue;
    const RTCRayHit8& p = rays.packets[i / 8];
    const RayMesh& mesh = *instances[i]->mesh;
    corners[i] = mesh.mesh->indices.data() + mesh.parts[p.hit.geomID[i % 8]].first_index +
                 3 * static_cast<std::size_t>(p.hit.primID[i % 8]);
    __builtin_prefetch(corners[i]);
  }
  for (unsigned i = 0; i < n; ++i) {
    if (instances[i] == nullptr) continue;
    const Vertex* const vertices = instances[i]->mesh->mesh->vertices.data();
    for (int k = 0; k < 3; ++k) {
      const char* const v = reinterpret_cast<const char*>(&vertices[corners[i][k]]);
      __builtin_prefetch(v);
      __builtin_prefetch(v + sizeof(Vertex) - 1);
    }
  }
}

SurfacePoint RayScene::point(const double origin[3], const float direction[3], float time,
                             const Intersection& met) const noexcept {
  using Eigen::Vector3d;
  using Eigen::Vector3f;
  const Owner owned = owner(met.instance);
  const RayInstance& instance = owned.batch->batch->instances[owned.index];
  const RayMesh& mesh = *instance.mesh;
  const RayPart& part = mesh.parts[met.part];
  const Placement at = placement(owned, time);
  const auto corner = corners_of(instance, met);
  const Vertex &a = *corner[0], &b = *corner[1], &c = *corner[2];
  const auto place = [](const Vertex& v) { return Vector3d(v.position[0], v.position[1], v.position[2]); };

  // Möller and Trumbore in the mesh's axes, in double: Embree's own range has the float error of where the
  // ray starts and of its kernel.
  const Vector3d o(origin[0], origin[1], origin[2]);
  const Vector3d d(direction[0], direction[1], direction[2]);
  const Vector3d d_mesh = at.inverse * d;
  const Vector3d va = place(a), e1 = place(b) - va, e2 = place(c) - va;
  const Vector3d to_a = va - at.inverse * (o - at.position);
  const Vector3d n = e1.cross(e2);
  const double along = n.dot(d_mesh);
  const Vector3d r = to_a.cross(d_mesh);
  const double t = n.dot(to_a) / along;
  double u = r.dot(e2) / along, v = -r.dot(e1) / along;
  SurfacePoint p;
  if (std::isfinite(t) && std::isfinite(u) && std::isfinite(v)) {
    p.range_m = t;
    // Met by Embree's float just outside.
    u = std::clamp(u, 0.0, 1.0);
    v = std::clamp(v, 0.0, 1.0 - u);
  } else {
    p.range_m = met.range_m;
    u = met.u;
    v = met.v;
  }
  const auto fu = static_cast<float>(u), fv = static_cast<float>(v), fw = 1.0F - fu - fv;
  for (int k = 0; k < 2; ++k) p.uv[k] = fw * a.uv[k] + fu * b.uv[k] + fv * c.uv[k];

  const bool back = (along > 0) != (instance.mirrored != 0);
  const Eigen::Matrix3d to_world = at.inverse.transpose();  // of normals
  Vector3d plane = (to_world * n).normalized();
  if (plane.dot(d) > 0) plane = -plane;
  const Vector3f bent(fw * a.normal[0] + fu * b.normal[0] + fv * c.normal[0],
                      fw * a.normal[1] + fu * b.normal[1] + fv * c.normal[1],
                      fw * a.normal[2] + fu * b.normal[2] + fv * c.normal[2]);
  Vector3d flat = to_world * bent.cast<double>();
  const double length = flat.norm();
  if (length > 1e-12 && std::isfinite(length)) {
    flat /= length;
    if (back) flat = -flat;
  } else {
    flat = plane;  // no normal given
  }
  Vector3d normal = flat;
  if (part.surface->normal != nullptr) {
    // Mikkelsen (2010), as in material_sample.glsl, with the triangle's edges for the picture's differences.
    const Eigen::Matrix3d forward = at.inverse.inverse();
    const Vector3d w1 = forward * e1, w2 = forward * e2;
    const double du1 = b.uv[0] - a.uv[0], du2 = c.uv[0] - a.uv[0], dv1 = b.uv[1] - a.uv[1],
                 dv2 = c.uv[1] - a.uv[1];
    const Vector3d x = w2.cross(flat), y = flat.cross(w1);
    const double side = w1.cross(w2).dot(d) < 0 ? 1.0 : -1.0;
    const Vector3d right = side * (x * du1 + y * du2), down = side * (x * dv1 + y * dv2);
    const double longest = std::max(right.squaredNorm(), down.squaredNorm());
    if (longest > 0 && std::isfinite(longest)) {
      const Vector3f m = mapped_normal(*part.surface, p.uv[0], p.uv[1]);
      const double scale = 1 / std::sqrt(longest);
      normal = (right * (scale * static_cast<double>(m.x())) - down * (scale * static_cast<double>(m.y())) +
                flat * static_cast<double>(std::max(m.z(), 0.05F)))
                   .normalized();
    }
  }
  for (int k = 0; k < 3; ++k) {
    p.shading_normal[k] = static_cast<float>(flat[k]);
    p.normal[k] = static_cast<float>(normal[k]);
    p.triangle_normal[k] = static_cast<float>(plane[k]);
    p.place[k] = static_cast<float>(o[k] + p.range_m * d[k]);
    p.tint[k] = instance.tint[k];
  }
  p.surface = part.surface.get();
  p.node = instance.node;
  return p;
}

}  // namespace rigor::render
