#include "sim/render/rays/embree_placement.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

namespace rigor::render {
namespace {

constexpr double kFarthestPlace_m = 1e12;
/// From how many instances on a batch has a structure of its own: of ground cover, whose batches lie beside
/// each other; and of anything else, whose batches lie through each other, so that a ray would walk through
/// them all.
constexpr std::size_t kManySmall = 48, kMany = 4096;
constexpr std::uint32_t kSmall_triangles = 256;

struct Pose {
  Eigen::Vector3f position, scale;
  Eigen::Quaternionf rotation;
};

/// As the Vulkan engine places it (resident_content.cpp); false where it cannot be placed.
bool pose_of(const Instance& a, Pose& out) {
  const auto all = [](const float* v) {
    return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
  };
  const float length = std::sqrt(a.rotation[0] * a.rotation[0] + a.rotation[1] * a.rotation[1] +
                                 a.rotation[2] * a.rotation[2] + a.rotation[3] * a.rotation[3]);
  if (!all(a.position) || !all(a.scale) || !all(a.tint) || !std::isfinite(a.phase) ||
      !std::isfinite(length) || !(length > 1e-6F))
    return false;
  const float k = 1.0F / length;
  out.position = Eigen::Map<const Eigen::Vector3f>(a.position);
  out.scale = Eigen::Map<const Eigen::Vector3f>(a.scale);
  out.rotation =
      Eigen::Quaternionf(a.rotation[3] * k, a.rotation[0] * k, a.rotation[1] * k, a.rotation[2] * k);
  // Without extent along an axis it has no inside and no normals.
  return out.scale.cwiseAbs().minCoeff() > 1e-12F &&
         static_cast<double>(out.scale.cwiseAbs().maxCoeff()) < kFarthestPlace_m;
}

NodeId node_of(const Batch& b, std::size_t i) { return i < b.nodes.size() ? b.nodes[i] : b.node; }

/// Embree's instance; `offset`: of the batch's origin from the place that the scene is about.
RTCGeometry instance_geometry(RTCDevice device, const RayBatch& b, std::size_t n,
                              const Eigen::Vector3d& offset) {
  const RayInstance& i = b.instances[n];
  RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(g, i.mesh->scene);
  rtcSetGeometryMask(g, b.casts_shadow ? kSeenMask | kShadowMask : kSeenMask);
  if (i.motion == kStill) {
    const Eigen::Matrix3d inverse = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(i.inverse);
    Eigen::Matrix<float, 3, 4> m;
    m.leftCols<3>() = inverse.inverse().cast<float>();
    m.col(3) = (offset + Eigen::Map<const Eigen::Vector3d>(i.position)).cast<float>();
    rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, m.data());
  } else {
    const auto& poses = b.motions[i.motion].poses;
    rtcSetGeometryTimeStepCount(g, static_cast<unsigned>(poses.size()));
    for (std::size_t k = 0; k < poses.size(); ++k) {
      const Eigen::Vector3f scale = poses[k].scale.cast<float>();
      const Eigen::Quaternionf r = poses[k].rotation.cast<float>();
      const Eigen::Vector3f at = (offset + poses[k].position).cast<float>();
      RTCQuaternionDecomposition q;
      rtcInitQuaternionDecomposition(&q);
      rtcQuaternionDecompositionSetScale(&q, scale.x(), scale.y(), scale.z());
      rtcQuaternionDecompositionSetQuaternion(&q, r.w(), r.x(), r.y(), r.z());
      rtcQuaternionDecompositionSetTranslation(&q, at.x(), at.y(), at.z());
      rtcSetGeometryTransformQuaternion(g, static_cast<unsigned>(k), &q);
    }
  }
  rtcCommitGeometry(g);
  return g;
}

bool placeable(const Batch* b) {
  return b != nullptr && b->prototype != nullptr && !b->instances.empty() && b->origin.allFinite();
}

bool same_thing(const Batch& a, const Batch& b) {
  return a.prototype == b.prototype && a.node.value == b.node.value &&
         a.instances.size() == b.instances.size();
}

/// What is the same object in all frames once, what moves with all its frames. All can be placed.
std::vector<WantedBatch> match_frames(const std::vector<std::vector<const Batch*>>& frames) {
  const auto& first = frames.front();
  std::vector<WantedBatch> out;
  out.reserve(first.size());
  // Frames whose batches stand in the same order need no search.
  std::vector<std::vector<std::uint8_t>> taken(frames.size());
  std::vector<std::size_t> cursor(frames.size(), 0);
  for (std::size_t k = 1; k < frames.size(); ++k) taken[k].resize(frames[k].size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    const Batch* const b = first[i];
    WantedBatch w;
    w.frames.push_back(b);
    bool moves = false;
    for (std::size_t k = 1; k < frames.size(); ++k) {
      const auto& other = frames[k];
      const Batch* found = nullptr;
      // In the same place, or the next one that is the same thing.
      if (other.size() == first.size() && (other[i] == b || same_thing(*b, *other[i]))) {
        found = other[i];
      } else {
        for (std::size_t j = cursor[k]; j < other.size() && found == nullptr; ++j)
          if (taken[k][j] == 0 && other[j] == b) {
            found = b;
            taken[k][j] = 1;
          }
        for (std::size_t j = 0; j < other.size() && found == nullptr; ++j)
          if (taken[k][j] == 0 && same_thing(*b, *other[j])) {
            found = other[j];
            taken[k][j] = 1;
          }
      }
      if (found == nullptr) {
        moves = false;
        break;
      }
      moves = moves || found != b;
      w.frames.push_back(found);
    }
    if (!moves) w.frames.resize(1);
    out.push_back(std::move(w));
  }
  return out;
}

}  // namespace

SplitWindow split(const ContentWindow& window) {
  const std::size_t n = window.frames.size();
  SplitWindow out;
  std::vector<std::vector<const Batch*>> frames(n);  // of what moves, or of all
  bool alike = true;
  for (std::size_t k = 0; k < n; ++k) {
    std::size_t still = 0;
    for (const auto& b : window.frames[k]->batches) {
      if (!placeable(b.get())) continue;
      if (b->moves)
        frames[k].push_back(b.get());
      else if (k == 0)
        out.still.push_back(b.get());
      else
        alike = alike && still < out.still.size() && out.still[still++] == b.get();
    }
    alike = alike && (k == 0 || still == out.still.size());
  }
  if (alike) {
    out.moving = match_frames(frames);
    return out;
  }
  out.still.clear();
  for (std::size_t k = 0; k < n; ++k) {
    frames[k].clear();
    for (const auto& b : window.frames[k]->batches)
      if (placeable(b.get())) frames[k].push_back(b.get());
  }
  for (WantedBatch& w : match_frames(frames)) {
    if (w.frames.size() == 1 && !w.frames.front()->moves)
      out.still.push_back(w.frames.front());
    else
      out.moving.push_back(std::move(w));
  }
  return out;
}

std::shared_ptr<const RayBatch> make_batch(RTCDevice device, const WantedBatch& w) {
  const Batch& b = *w.frames.front();
  const std::size_t steps = w.frames.size();
  auto out = std::make_shared<RayBatch>();
  out->origin = b.origin;
  out->casts_shadow = b.prototype->casts_shadow;
  for (const Batch* f : w.frames) out->serials.push_back(f->serial);
  out->choice = w.choice;
  out->meshes = w.meshes;
  const auto structure = [&](const Mesh* m) -> const RayMesh* {
    for (const auto& r : out->meshes)
      if (r->mesh.get() == m) return r.get();
    return nullptr;
  };
  out->instances.resize(b.instances.size());
  std::vector<Pose> poses(steps);
  for (std::size_t n = 0; n < b.instances.size(); ++n) {
    const RayMesh* const mesh = structure(out->choice[out->choice.size() == 1 ? 0 : n]);
    RayInstance& i = out->instances[n];
    bool there = mesh != nullptr;
    for (std::size_t k = 0; k < steps && there; ++k)
      there = pose_of(w.frames[k]->instances[n], poses[k]) &&
              (w.frames[k]->origin - b.origin).cwiseAbs().maxCoeff() < kFarthestPlace_m &&
              static_cast<double>(poses[k].position.cwiseAbs().maxCoeff()) < kFarthestPlace_m;
    if (!there) {
      ++out->left_out;
      continue;
    }
    if (mesh->scene == nullptr) continue;
    const Eigen::Quaterniond rotation = poses[0].rotation.cast<double>();
    const Eigen::Vector3d scale = poses[0].scale.cast<double>();
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(i.inverse) =
        scale.cwiseInverse().asDiagonal() * rotation.toRotationMatrix().transpose();
    Eigen::Map<Eigen::Vector3d>(i.position) = poses[0].position.cast<double>();
    i.mesh = mesh;
    ++out->present;
    i.node = node_of(b, n);
    std::copy(b.instances[n].tint, b.instances[n].tint + 3, i.tint);
    i.mirrored = scale.prod() < 0 ? 1 : 0;
    if (steps == 1) continue;
    i.motion = static_cast<std::uint32_t>(out->motions.size()) & kStill;
    RayMotion motion;
    for (std::size_t k = 0; k < steps; ++k)
      motion.poses.push_back({w.frames[k]->origin - b.origin + poses[k].position.cast<double>(),
                              poses[k].rotation.cast<double>(), poses[k].scale.cast<double>()});
    out->motions.push_back(std::move(motion));
  }

  const bool small = std::all_of(out->meshes.begin(), out->meshes.end(),
                                 [](const auto& m) { return m->triangles <= kSmall_triangles; });
  if (steps > 1 || b.instances.size() < (small ? kManySmall : kMany)) return out;
  out->scene = rtcNewScene(device);
  rtcSetSceneFlags(out->scene, RTC_SCENE_FLAG_ROBUST);
  for (std::size_t n = 0; n < out->instances.size(); ++n) {
    if (out->instances[n].mesh == nullptr) continue;
    RTCGeometry g = instance_geometry(device, *out, n, Eigen::Vector3d::Zero());
    rtcAttachGeometryByID(out->scene, g, static_cast<unsigned>(n));
    rtcReleaseGeometry(g);
  }
  rtcCommitScene(out->scene);
  return out;
}

void PlacedScene::bounds(const RTCBoundsFunctionArguments* a) {
  const auto& p = *static_cast<const Placed*>(a->geometryUserPtr);
  RTCBounds b;
  rtcGetSceneBounds(p.batch->scene, &b);
  // Wider than what rounding moves.
  const auto wider = [&](float low, float high, float shift, float& out_low, float& out_high) {
    const float pad = 1e-3F + 4e-6F * std::max({std::abs(low), std::abs(high), std::abs(shift)});
    out_low = low + shift - pad;
    out_high = high + shift + pad;
  };
  RTCBounds& o = *a->bounds_o;
  wider(b.lower_x, b.upper_x, p.shift[0], o.lower_x, o.upper_x);
  wider(b.lower_y, b.upper_y, p.shift[1], o.lower_y, o.upper_y);
  wider(b.lower_z, b.upper_z, p.shift[2], o.lower_z, o.upper_z);
}

/// Moves the origins of N rays while it lives; they come in rows, as Embree hands them on.
template <unsigned N>
struct PlacedScene::Rays {
  float* const origin;  ///< x, y and z of all
  float before[3 * N];
  Rays(void* rays, const float shift[3]) : origin(static_cast<float*>(rays)) {
    for (unsigned k = 0; k < 3 * N; ++k) {
      before[k] = origin[k];
      origin[k] = before[k] - shift[k / N];
    }
  }
  ~Rays() { std::copy_n(before, 3 * N, origin); }
  Rays(const Rays&) = delete;
  Rays& operator=(const Rays&) = delete;
};

/// What numbers of instances count from, while a batch with a structure of its own is walked through.
struct PlacedScene::Within {
  SceneContext& context;
  const std::uint32_t base = context.base;
  const unsigned outer = context.embree.instID[0];
  Within(RTCIntersectContext* c, const Placed& p) : context(*reinterpret_cast<SceneContext*>(c)) {
    context.base = base + p.base;
    context.embree.instID[0] = RTC_INVALID_GEOMETRY_ID;
  }
  ~Within() {
    context.base = base;
    context.embree.instID[0] = outer;
  }
  Within(const Within&) = delete;
  Within& operator=(const Within&) = delete;
};

template <unsigned N>
void PlacedScene::intersect_rays(const RTCIntersectFunctionNArguments* a) {
  const auto& p = *static_cast<const Placed*>(a->geometryUserPtr);
  unsigned* const ids = &RTCHitN_instID(RTCRayHitN_HitN(a->rayhit, N), N, 0, 0);
  unsigned before[N];
  std::copy_n(ids, N, before);
  std::fill_n(ids, N, RTC_INVALID_GEOMETRY_ID);
  {
    const Rays<N> shifted(a->rayhit, p.shift);
    const Within within(a->context, p);
    if constexpr (N == 8)
      rtcIntersect8(a->valid, p.batch->scene, a->context, reinterpret_cast<RTCRayHit8*>(a->rayhit));
    else
      rtcIntersect1(p.batch->scene, a->context, reinterpret_cast<RTCRayHit*>(a->rayhit));
  }
  for (unsigned k = 0; k < N; ++k) ids[k] = ids[k] == RTC_INVALID_GEOMETRY_ID ? before[k] : p.base + ids[k];
}

template <unsigned N>
void PlacedScene::occlude_rays(const RTCOccludedFunctionNArguments* a) {
  const auto& p = *static_cast<const Placed*>(a->geometryUserPtr);
  const Rays<N> shifted(a->ray, p.shift);
  const Within within(a->context, p);
  if constexpr (N == 8)
    rtcOccluded8(a->valid, p.batch->scene, a->context, reinterpret_cast<RTCRay8*>(a->ray));
  else
    rtcOccluded1(p.batch->scene, a->context, reinterpret_cast<RTCRay*>(a->ray));
}

// As many as were shot, eight or one (embree_scene.cpp): Embree hands on the packet with the lanes that
// matter.
void PlacedScene::intersect(const RTCIntersectFunctionNArguments* a) {
  if (a->N == 8)
    intersect_rays<8>(a);
  else if (a->N == 1)
    intersect_rays<1>(a);
}

void PlacedScene::occluded(const RTCOccludedFunctionNArguments* a) {
  if (a->N == 8)
    occlude_rays<8>(a);
  else if (a->N == 1)
    occlude_rays<1>(a);
}

PlacedScene::PlacedScene(std::shared_ptr<MeshCache> cache, const Eigen::Vector3d& origin)
    : cache_(std::move(cache)) {
  origin_ = origin;
  for (Level* const l : {&still_, &moving_}) {
    l->handle = rtcNewScene(cache_->device());
    rtcSetSceneFlags(l->handle, RTC_SCENE_FLAG_ROBUST);
  }
}

PlacedScene::~PlacedScene() {
  for (Level* const l : {&still_, &moving_}) {
    rtcReleaseScene(l->handle);
    for (const auto& p : l->batches)
      for (RTCGeometry g : p->geometries)
        if (g != nullptr) rtcReleaseGeometry(g);
  }
}

void PlacedScene::attach(Level& level, Placed& p) {
  const RayBatch& b = *p.batch;
  if (p.geometries.empty() && b.scene != nullptr) {
    RTCGeometry g = rtcNewGeometry(cache_->device(), RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(g, 1);
    rtcSetGeometryUserData(g, &p);
    rtcSetGeometryBoundsFunction(g, bounds, nullptr);
    rtcSetGeometryIntersectFunction(g, intersect);
    rtcSetGeometryOccludedFunction(g, occluded);
    rtcSetGeometryMask(g, b.casts_shadow ? kSeenMask | kShadowMask : kSeenMask);
    rtcCommitGeometry(g);
    p.geometries = {g};
  } else if (p.geometries.empty()) {
    p.geometries.resize(b.instances.size());
    for (std::size_t n = 0; n < p.geometries.size(); ++n)
      if (b.instances[n].mesh != nullptr)
        p.geometries[n] = instance_geometry(cache_->device(), b, n, p.offset);
  }
  for (std::uint32_t n = 0; n < p.geometries.size(); ++n)
    if (p.geometries[n] != nullptr) rtcAttachGeometryByID(level.handle, p.geometries[n], p.first + n);
}

void PlacedScene::detach(Level& level, Placed& p) {
  for (std::uint32_t n = 0; n < p.geometries.size(); ++n)
    if (p.geometries[n] != nullptr) rtcDetachGeometry(level.handle, p.first + n);
}

Status PlacedScene::place(const WantedContent& wanted) {
  const ContentFrame& frame = wanted.window->first();
  weather_.wetness = std::isfinite(frame.surface.wetness) ? std::clamp(frame.surface.wetness, 0.0F, 1.0F) : 0;
  weather_.snow_depth_m =
      std::isfinite(frame.surface.snow_depth_m) ? std::max(frame.surface.snow_depth_m, 0.0F) : 0;
  for (int k = 0; k < 3; ++k)
    weather_.cell[k] = static_cast<float>(origin_[k] - std::floor(origin_[k] / 1024) * 1024);
  if (still_version_ == wanted.still_version && moving_version_ == wanted.moving_version) return {};
  if (still_version_ != wanted.still_version) {
    static std::atomic<std::uint64_t> last{0};
    still_serial_ = ++last;
    place(still_, wanted.still);
  }
  if (moving_version_ != wanted.moving_version) place(moving_, wanted.moving);
  moving_.first = still_.end();
  if (const std::string c = cache_->complaint(); !c.empty()) return fail(ErrorCode::unavailable, "embree", c);
  still_version_ = wanted.still_version;
  moving_version_ = wanted.moving_version;
  return {};
}

void PlacedScene::place(Level& level, const std::vector<WantedBatch>& wanted) {
  // Where every batch has room in its old place, what stays is not touched; else all are numbered anew in
  // the order of the content. Their order is the same either way, and so is what Embree makes of it.
  const auto ids = [](const RayBatch& b) {
    return b.scene != nullptr ? 1U : static_cast<std::uint32_t>(b.instances.size());
  };
  auto& batches = level.batches;
  bool in_place = batches.size() == wanted.size();
  for (std::size_t i = 0; i < batches.size() && in_place; ++i)
    in_place = ids(*wanted[i].made) <= batches[i]->room;
  std::vector<std::unique_ptr<Placed>> gone;
  const auto placed = [&](const std::shared_ptr<const RayBatch>& b) {
    auto p = std::make_unique<Placed>();
    p->batch = b;
    p->offset = b->origin - origin_;
    for (int k = 0; k < 3; ++k) p->shift[k] = static_cast<float>(p->offset[k]);
    return p;
  };
  if (in_place) {
    for (std::size_t i = 0; i < batches.size(); ++i) {
      auto& slot = batches[i];
      if (slot->batch == wanted[i].made) continue;
      detach(level, *slot);
      auto p = placed(wanted[i].made);
      p->first = slot->first;
      p->room = slot->room;
      attach(level, *p);
      std::swap(slot, p);
      gone.push_back(std::move(p));
    }
  } else {
    std::unordered_map<const RayBatch*, std::unique_ptr<Placed>> old;
    for (auto& p : batches) {
      detach(level, *p);
      const RayBatch* const key = p->batch.get();
      if (auto& slot = old[key]; !slot)
        slot = std::move(p);
      else
        gone.push_back(std::move(p));
    }
    batches.clear();
    std::uint32_t next = 0;
    for (const WantedBatch& w : wanted) {
      const auto it = old.find(w.made.get());
      std::unique_ptr<Placed> p;
      if (it != old.end() && it->second)
        p = std::move(it->second);
      else
        p = placed(w.made);
      p->first = next;
      p->room = ids(*w.made);
      next += p->room;
      attach(level, *p);
      batches.push_back(std::move(p));
    }
    for (auto& [key, p] : old)
      if (p) gone.push_back(std::move(p));
  }
  level.holes_shade = std::any_of(batches.begin(), batches.end(), [](const auto& p) {
    const auto& meshes = p->batch->meshes;
    return p->batch->casts_shadow &&
           std::any_of(meshes.begin(), meshes.end(), [](const auto& m) { return m && m->holes; });
  });
  level.top = batches.empty() ? 0 : batches.back()->first + batches.back()->room;
  level.of_top.assign(level.top, nullptr);
  level.of_block.clear();
  for (const auto& p : batches) {
    if (p->batch->scene == nullptr) {
      p->base = p->first;
      std::fill_n(level.of_top.begin() + p->first, p->batch->instances.size(), p.get());
      continue;
    }
    p->base = level.top + static_cast<std::uint32_t>(level.of_block.size()) * kBlock;
    level.of_block.resize(level.of_block.size() + (p->batch->instances.size() + kBlock - 1) / kBlock,
                          p.get());
  }
  rtcCommitScene(level.handle);
  for (const auto& p : gone)
    for (RTCGeometry g : p->geometries)
      if (g != nullptr) rtcReleaseGeometry(g);
}

}  // namespace rigor::render
