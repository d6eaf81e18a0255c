#include "sim/render/rays/embree_cache.h"

#include "sim/render/rays/embree_placement.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <new>

namespace rigor::render {
namespace {

/// Embree leaves out what lies beyond, and so do we.
constexpr float kFarthest_m = 1e18F;

bool placed(const Vertex& v) {
  return std::abs(v.position[0]) < kFarthest_m && std::abs(v.position[1]) < kFarthest_m &&
         std::abs(v.position[2]) < kFarthest_m;
}

/// Of 255: a wide ray of which less is leaf meets none, one of which more is meets nothing else.
constexpr std::uint8_t kAllHole = 7, kAllLeaf = 248;

/// A hit on the map of its triangle.
struct OnMap {
  const HoledTriangle& triangle;
  float u, v;
};
OnMap on_map(const RayPart& part, RTCHitN* hit, unsigned n, unsigned i) {
  const float u = RTCHitN_u(hit, n, i), v = RTCHitN_v(hit, n, i), w = 1 - u - v;
  const HoledTriangle& t = part.holed[RTCHitN_primID(hit, n, i)];
  return {t, w * t.uv[0] + u * t.uv[2] + v * t.uv[4], w * t.uv[1] + u * t.uv[3] + v * t.uv[5]};
}

/// How much of a wide ray is leaf where it meets a map, of 255.
std::uint8_t leaf_of(const RayPart& part, const OnMap& at, const WideRays& rays,
                     const RTCFilterFunctionNArguments* a, unsigned i) {
  const unsigned n = a->N;
  // The direction is in the mesh's axes, as long as a metre of the world is there. (Of a mesh that is
  // scaled unevenly: along the ray.)
  const float x = RTCRayN_dir_x(a->ray, n, i), y = RTCRayN_dir_y(a->ray, n, i),
              z = RTCRayN_dir_z(a->ray, n, i);
  const float half_width_m =
      rays.half_width_m[RTCRayN_id(a->ray, n, i)] + rays.half_width_per_m * RTCRayN_tfar(a->ray, n, i);
  const float side = 2 * half_width_m * std::sqrt(x * x + y * y + z * z) * at.triangle.texels_per_m;
  return part.surface->holes->leaf_at(at.u, at.v, side);
}

/// A ray that meets all of a map's width ends there, one that meets a part of it goes on.
void note_layers(const RTCFilterFunctionNArguments* a, const SceneContext& context) {
  const auto& part = *static_cast<const RayPart*>(a->geometryUserPtr);
  LayerWalk& walk = *context.layers;
  const unsigned n = a->N;
  for (unsigned i = 0; i < n; ++i) {
    if (a->valid[i] != -1) continue;
    if (part.one_sided && RayScene::looks_away(context, a, i)) {
      a->valid[i] = 0;
      continue;
    }
    const std::uint8_t leaf = leaf_of(part, on_map(part, a->hit, n, i), walk.rays, a, i);
    if (leaf >= kAllLeaf) continue;
    if (leaf <= kAllHole ||
        walk.add(RTCRayN_id(a->ray, n, i), {{RTCRayN_tfar(a->ray, n, i), RTCHitN_u(a->hit, n, i),
                                             RTCHitN_v(a->hit, n, i), context.base + a->context->instID[0],
                                             RTCHitN_geomID(a->hit, n, i), RTCHitN_primID(a->hit, n, i)},
                                            static_cast<float>(leaf) / 255}))
      a->valid[i] = 0;
  }
}

void leave_out_holes(const RTCFilterFunctionNArguments* a) {
  const auto& context = *reinterpret_cast<const SceneContext*>(a->context);
  if (context.layers != nullptr) {
    note_layers(a, context);
    return;
  }
  const auto& part = *static_cast<const RayPart*>(a->geometryUserPtr);
  const unsigned n = a->N;
  for (unsigned i = 0; i < n; ++i) {
    if (a->valid[i] != -1) continue;
    const OnMap at = on_map(part, a->hit, n, i);
    if (part.surface->holes->hole_at(at.u, at.v)) a->valid[i] = 0;
  }
}

/// WideWalk::cover of a surface of which so much, of 255, is leaf.
const std::array<std::uint32_t, 256> kCoverOfLeaf = [] {
  std::array<std::uint32_t, 256> out{};
  for (std::size_t i = 0; i < 255; ++i)
    out[i] =
        static_cast<std::uint32_t>(-std::log2(1 - static_cast<float>(i) / 255) * WideWalk::kUnitsAHalving);
  out[255] = 1U << 24U;
  return out;
}();

void cover_light(const RTCFilterFunctionNArguments* a) {
  const auto& context = *reinterpret_cast<const SceneContext*>(a->context);
  WideWalk* const walk = context.wide;
  if (walk == nullptr) {
    leave_out_holes(a);
    return;
  }
  const auto& part = *static_cast<const RayPart*>(a->geometryUserPtr);
  const unsigned n = a->N;
  for (unsigned i = 0; i < n; ++i) {
    if (a->valid[i] != -1) continue;
    if (walk->fronts_alone && part.one_sided && RayScene::looks_away(context, a, i)) {
      a->valid[i] = 0;
      continue;
    }
    std::uint32_t& cover = walk->cover[RTCRayN_id(a->ray, n, i)];
    cover += kCoverOfLeaf[leaf_of(part, on_map(part, a->hit, n, i), walk->rays, a, i)];
    if (cover <= walk->most) a->valid[i] = 0;
  }
}

}  // namespace

RayMesh::~RayMesh() {
  if (scene != nullptr) rtcReleaseScene(scene);
}

Result<std::shared_ptr<EmbreeCache>> EmbreeCache::create() {
  RTCDevice device = rtcNewDevice("");
  if (device == nullptr)
    return fail(ErrorCode::unavailable, "embree",
                "no device (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  return std::make_shared<MeshCache>(device);
}

MeshCache::MeshCache(RTCDevice device) : device_(device) {}
MeshCache::~MeshCache() { rtcReleaseDevice(device_); }

std::string MeshCache::complaint() const {
  switch (rtcGetDeviceError(device_)) {
    case RTC_ERROR_NONE:
      return "";
    case RTC_ERROR_OUT_OF_MEMORY:
      return "out of memory";
    case RTC_ERROR_INVALID_ARGUMENT:
      return "invalid argument";
    case RTC_ERROR_INVALID_OPERATION:
      return "invalid operation";
    case RTC_ERROR_UNSUPPORTED_CPU:
      return "this CPU is not supported";
    default:
      return "unknown error";
  }
}

std::shared_ptr<const LeafCover> MeshCache::cover(const std::shared_ptr<const Texture>& map,
                                                  float alpha_cutoff) {
  std::shared_ptr<Slot<LeafCover>> slot;
  {
    const std::lock_guard lock(mutex_);
    auto& s = covers_[{map->serial, alpha_cutoff}];
    if (!s) s = std::make_shared<Slot<LeafCover>>();
    slot = s;
  }
  const std::lock_guard lock(slot->making);
  auto made = slot->made.lock();
  if (!made) slot->made = made = std::make_shared<const LeafCover>(*map, alpha_cutoff);
  return made;
}

std::shared_ptr<const RaySurface> MeshCache::surface(const std::shared_ptr<const Surface>& s) {
  const std::uint64_t serial = s ? s->serial : 0;
  const auto find = [&] { return surfaces_[serial].lock(); };
  {
    const std::lock_guard lock(mutex_);
    if (auto there = find()) return there;
  }
  auto made = std::make_shared<const RaySurface>(
      s, s && has_holes(*s) ? cover(s->colour_map, s->alpha_cutoff) : nullptr);
  const std::lock_guard lock(mutex_);
  if (auto there = find()) return there;  // two threads may do so at once: the first one counts
  surfaces_[serial] = made;
  return made;
}

PrototypeSphere MeshCache::sphere(const Prototype& p) {
  const std::lock_guard lock(mutex_);
  const auto [it, fresh] = spheres_.try_emplace(p.serial);
  PrototypeSphere& s = it->second;
  if (!fresh) return s;
  Eigen::AlignedBox3d box;
  const Mesh* const mesh = p.levels.empty() ? nullptr : p.levels.front().mesh.get();
  if (mesh == nullptr) return s;
  const auto at = [](const Vertex& v) {
    return Eigen::Vector3d(v.position[0], v.position[1], v.position[2]);
  };
  for (const Vertex& v : mesh->vertices)
    if (placed(v)) box.extend(at(v));
  if (box.isEmpty()) return s;
  s.centre = box.center();
  for (const Vertex& v : mesh->vertices)
    if (placed(v)) s.radius_m = std::max(s.radius_m, (at(v) - s.centre).norm());
  return s;
}

std::shared_ptr<const RayBatch> MeshCache::get(const WantedBatch& w) {
  const std::uint64_t key = w.frames.front()->serial;
  const auto is = [&](const RayBatch& b) {
    return std::equal(b.serials.begin(), b.serials.end(), w.frames.begin(), w.frames.end(),
                      [](std::uint64_t serial, const Batch* f) { return serial == f->serial; }) &&
           b.choice == w.choice;
  };
  const auto find = [&]() -> std::shared_ptr<const RayBatch> {
    for (const auto& weak : batches_[key])
      if (auto b = weak.lock(); b && is(*b)) return b;
    return nullptr;
  };
  {
    const std::lock_guard lock(mutex_);
    if (auto b = find()) return b;
  }
  auto made = make_batch(device_, w);  // two engines may do so at once: the first one counts
  const std::lock_guard lock(mutex_);
  if (auto b = find()) return b;
  if (batches_.size() >= sweep_batches_at_) {
    for (auto it = batches_.begin(); it != batches_.end();) {
      std::erase_if(it->second, [](const auto& weak) { return weak.expired(); });
      it = it->second.empty() ? batches_.erase(it) : std::next(it);
    }
    sweep_batches_at_ = std::max<std::size_t>(4096, 2 * batches_.size());
  }
  batches_[key].push_back(made);
  return made;
}

Result<std::shared_ptr<const RayMesh>> MeshCache::get(const std::shared_ptr<const Mesh>& mesh, bool& built) {
  built = false;
  std::shared_ptr<Slot<RayMesh>> slot;
  {
    const std::lock_guard lock(mutex_);
    if (meshes_.size() >= sweep_at_) {
      std::erase_if(meshes_,
                    [](const auto& e) { return e.second.use_count() == 1 && e.second->made.expired(); });
      std::erase_if(surfaces_, [](const auto& e) { return e.second.expired(); });
      std::erase_if(covers_,
                    [](const auto& e) { return e.second.use_count() == 1 && e.second->made.expired(); });
      sweep_at_ = std::max<std::size_t>(1024, 2 * meshes_.size());
    }
    auto& s = meshes_[mesh->serial];
    if (!s) s = std::make_shared<Slot<RayMesh>>();
    slot = s;
  }
  const std::lock_guard lock(slot->making);
  if (auto there = slot->made.lock()) return there;
  // While it holds the lock this thread must not pick up another mesh's work: that one may wait for ours.
  Result<std::shared_ptr<const RayMesh>> made = tbb::this_task_arena::isolate([&] { return build(mesh); });
  if (!made) return made;
  built = true;
  slot->made = *made;
  return made;
}

Result<std::shared_ptr<const RayMesh>> MeshCache::build(const std::shared_ptr<const Mesh>& mesh) {
  auto out = std::make_shared<RayMesh>();
  out->mesh = mesh;
  const Mesh& m = *mesh;
  out->parts.reserve(m.parts.size());  // Embree keeps their addresses
  for (const MeshPart& part : m.parts) {
    const std::uint32_t triangles = part.index_count / 3;
    if (part.first_index > m.indices.size() || part.index_count > m.indices.size() - part.first_index) {
      out->left_out += triangles;
      continue;
    }
    if (triangles == 0) continue;
    const auto begin = m.indices.begin() + part.first_index;
    if (std::any_of(begin, begin + 3 * static_cast<std::ptrdiff_t>(triangles),
                    [&](std::uint32_t i) { return i >= m.vertices.size(); })) {
      out->left_out += triangles;
      continue;
    }
    RayPart r;
    r.surface = surface(part.surface);
    r.first_index = part.first_index;
    r.triangles = triangles;
    r.one_sided = !r.surface->surface->two_sided;
    if (r.surface->holes) r.holed.reserve(triangles);
    out->one_sided = out->one_sided || r.one_sided;
    out->holes = out->holes || r.surface->holes;
    for (std::size_t i = 0; i < triangles; ++i) {
      const auto corner = [&](std::size_t k) -> const Vertex& {
        return m.vertices[*(begin + static_cast<std::ptrdiff_t>(3 * i + k))];
      };
      const auto at = [&](std::size_t k) { return Eigen::Map<const Eigen::Vector3f>(corner(k).position); };
      const bool there = placed(corner(0)) && placed(corner(1)) && placed(corner(2));
      const Eigen::Vector3f across = (at(1) - at(0)).cross(at(2) - at(0));
      if (!there || across.isZero(0)) ++out->left_out;
      if (!r.surface->holes) continue;
      HoledTriangle& t = r.holed.emplace_back();
      for (std::size_t k = 0; k < 3; ++k) std::copy_n(corner(k).uv, 2, &t.uv[2 * k]);
      const float part_of_map =
          std::abs((t.uv[2] - t.uv[0]) * (t.uv[5] - t.uv[1]) - (t.uv[4] - t.uv[0]) * (t.uv[3] - t.uv[1]));
      const auto texels =
          static_cast<float>(r.surface->holes->width()) * static_cast<float>(r.surface->holes->height());
      t.texels_per_m = std::sqrt(part_of_map * texels / std::max(across.norm(), 1e-20F));
    }
    out->triangles += triangles;
    out->parts.push_back(std::move(r));
  }
  if (out->parts.empty()) return out;

  out->scene = rtcNewScene(device_);
  rtcSetSceneFlags(
      out->scene, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
  rtcSetSceneBuildQuality(out->scene, RTC_BUILD_QUALITY_MEDIUM);
  for (std::size_t i = 0; i < out->parts.size(); ++i) {
    RayPart& r = out->parts[i];
    RTCGeometry g = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, m.vertices.data(),
                               offsetof(Vertex, position), sizeof(Vertex), m.vertices.size());
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, m.indices.data(),
                               r.first_index * sizeof(std::uint32_t), 3 * sizeof(std::uint32_t), r.triangles);
    rtcSetGeometryMask(g, ~0U);
    rtcSetGeometryUserData(g, &r);
    if (r.surface->holes) {
      rtcSetGeometryIntersectFilterFunction(g, leave_out_holes);
      rtcSetGeometryOccludedFilterFunction(g, cover_light);
    }
    rtcCommitGeometry(g);
    rtcAttachGeometryByID(out->scene, g, static_cast<unsigned>(i));
    rtcReleaseGeometry(g);
  }
  rtcCommitScene(out->scene);
  if (const std::string c = complaint(); !c.empty()) return fail(ErrorCode::unavailable, "embree", c);
  return out;
}

}  // namespace rigor::render
