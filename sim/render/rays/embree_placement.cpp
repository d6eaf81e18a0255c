#include "sim/render/rays/embree_placement.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace rigor::render {
namespace {

constexpr double kFarthest_m = 1e12;

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
         static_cast<double>(out.scale.cwiseAbs().maxCoeff()) < kFarthest_m;
}

NodeId node_of(const Batch& b, std::size_t i) { return i < b.nodes.size() ? b.nodes[i] : b.node; }

bool placeable(const Batch* b) {
  return b != nullptr && b->prototype != nullptr && !b->instances.empty() && b->origin.allFinite();
}

bool same_thing(const Batch& a, const Batch& b) {
  return a.prototype == b.prototype && a.node.value == b.node.value &&
         a.instances.size() == b.instances.size();
}

}  // namespace

std::vector<WantedBatch> match_frames(const ContentWindow& window) {
  const auto& frames = window.frames;
  const auto& first = frames.front()->batches;
  std::vector<WantedBatch> out;
  out.reserve(first.size());
  // Frames whose batches stand in the same order need no search.
  std::vector<std::vector<std::uint8_t>> taken(frames.size());
  std::vector<std::size_t> cursor(frames.size(), 0);
  for (std::size_t k = 1; k < frames.size(); ++k) taken[k].resize(frames[k]->batches.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    const Batch* const b = first[i].get();
    if (!placeable(b)) continue;
    WantedBatch w;
    w.frames.push_back(b);
    bool moves = false, lost = false;
    for (std::size_t k = 1; k < frames.size() && !lost; ++k) {
      const auto& other = frames[k]->batches;
      const Batch* found = nullptr;
      // In the same place, or the next one that is the same thing.
      if (i < other.size() && other.size() == first.size() && other[i] != nullptr &&
          (other[i].get() == b || same_thing(*b, *other[i]))) {
        found = other[i].get();
      } else {
        for (std::size_t j = cursor[k]; j < other.size() && found == nullptr; ++j)
          if (taken[k][j] == 0 && other[j] != nullptr && other[j].get() == b) {
            found = b;
            taken[k][j] = 1;
          }
        for (std::size_t j = 0; j < other.size() && found == nullptr; ++j)
          if (taken[k][j] == 0 && placeable(other[j].get()) && same_thing(*b, *other[j])) {
            found = other[j].get();
            taken[k][j] = 1;
          }
      }
      if (found == nullptr || !placeable(found)) {
        lost = true;
        break;
      }
      moves = moves || found != b;
      w.frames.push_back(found);
    }
    if (!moves || lost) w.frames.resize(1);
    out.push_back(std::move(w));
  }
  return out;
}

PlacedScene::PlacedScene(std::shared_ptr<MeshCache> cache, const Eigen::Vector3d& origin)
    : cache_(std::move(cache)) {
  origin_ = origin;
  handle_ = rtcNewScene(cache_->device());
  rtcSetSceneFlags(handle_, RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(handle_, RTC_BUILD_QUALITY_MEDIUM);
}

PlacedScene::~PlacedScene() {
  if (handle_ != nullptr) rtcReleaseScene(handle_);
  for (RTCGeometry g : geometries_)
    if (g != nullptr) rtcReleaseGeometry(g);
}

bool PlacedScene::Range::is(const WantedBatch& b) const {
  if (serials.size() != b.frames.size() || meshes != b.meshes) return false;
  for (std::size_t k = 0; k < serials.size(); ++k)
    if (serials[k] != b.frames[k]->serial) return false;
  return true;
}

void PlacedScene::clear(const Range& range) {
  for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
    if (instances_[i].motion != kStill) {
      motions_[instances_[i].motion].poses.clear();
      free_motions_.push_back(instances_[i].motion);
    }
    instances_[i] = RayInstance{};
    if (geometries_[i] == nullptr) continue;
    rtcDetachGeometry(handle_, i);
    rtcReleaseGeometry(geometries_[i]);
    geometries_[i] = nullptr;
  }
}

void PlacedScene::fill(const WantedBatch& w, Range& range) {
  const Batch& b = *w.frames.front();
  const std::size_t steps = w.frames.size();
  range.serials.clear();
  for (const Batch* f : w.frames) range.serials.push_back(f->serial);
  range.meshes = w.meshes;
  range.count = static_cast<std::uint32_t>(b.instances.size());
  range.left_out = 0;
  std::vector<Pose> poses(steps);
  std::vector<Eigen::Vector3d> origins(steps);
  for (std::size_t k = 0; k < steps; ++k) origins[k] = w.frames[k]->origin - origin_;
  for (std::size_t n = 0; n < b.instances.size(); ++n) {
    const RayMesh* const mesh = w.mesh(n);
    RayInstance& out = instances_[range.first + n];
    out = RayInstance{};
    bool there = mesh != nullptr;
    for (std::size_t k = 0; k < steps && there; ++k) {
      there = pose_of(w.frames[k]->instances[n], poses[k]);
      there = there && (origins[k] + poses[k].position.cast<double>()).cwiseAbs().maxCoeff() < kFarthest_m;
    }
    if (!there) {
      ++range.left_out;
      continue;
    }
    if (mesh->scene == nullptr) continue;
    const auto position = [&](std::size_t k) -> Eigen::Vector3d {
      return origins[k] + poses[k].position.cast<double>();
    };
    const Eigen::Quaterniond rotation = poses[0].rotation.cast<double>();
    const Eigen::Vector3d scale = poses[0].scale.cast<double>();
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(out.inverse) =
        scale.cwiseInverse().asDiagonal() * rotation.toRotationMatrix().transpose();
    Eigen::Map<Eigen::Vector3d>(out.position) = position(0);
    out.mesh = mesh;
    out.node = node_of(b, n);
    std::copy(b.instances[n].tint, b.instances[n].tint + 3, out.tint);
    out.mirrored = scale.prod() < 0 ? 1 : 0;

    RTCGeometry g = rtcNewGeometry(cache_->device(), RTC_GEOMETRY_TYPE_INSTANCE);
    rtcSetGeometryInstancedScene(g, mesh->scene);
    rtcSetGeometryMask(g, b.prototype->casts_shadow ? kSeenMask | kShadowMask : kSeenMask);
    rtcSetGeometryTimeStepCount(g, static_cast<unsigned>(steps));
    if (steps == 1) {
      Eigen::Matrix<float, 3, 4> m;
      m.leftCols<3>() = (rotation.toRotationMatrix() * scale.asDiagonal()).cast<float>();
      m.col(3) = position(0).cast<float>();
      rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, m.data());
    } else {
      std::uint32_t slot = 0;
      if (free_motions_.empty()) {
        slot = static_cast<std::uint32_t>(motions_.size());
        motions_.emplace_back();
      } else {
        slot = free_motions_.back();
        free_motions_.pop_back();
      }
      out.motion = slot & kStill;
      auto& motion = motions_[slot].poses;
      motion.clear();
      for (std::size_t k = 0; k < steps; ++k) {
        const Pose& p = poses[k];
        motion.push_back({position(k), p.rotation.cast<double>(), p.scale.cast<double>()});
        RTCQuaternionDecomposition q;
        rtcInitQuaternionDecomposition(&q);
        rtcQuaternionDecompositionSetScale(&q, p.scale.x(), p.scale.y(), p.scale.z());
        rtcQuaternionDecompositionSetQuaternion(&q, p.rotation.w(), p.rotation.x(), p.rotation.y(),
                                                p.rotation.z());
        const Eigen::Vector3f at = position(k).cast<float>();
        rtcQuaternionDecompositionSetTranslation(&q, at.x(), at.y(), at.z());
        rtcSetGeometryTransformQuaternion(g, static_cast<unsigned>(k), &q);
      }
    }
    rtcCommitGeometry(g);
    geometries_[range.first + n] = g;
  }
}

void PlacedScene::number_anew(const WantedContent& wanted) {
  // Geometries of batches that stay are moved to their new numbers.
  std::unordered_map<std::uint64_t, std::size_t> old;
  for (std::size_t i = 0; i < ranges_.size(); ++i) old.emplace(ranges_[i].serials.front(), i);
  for (std::uint32_t i = 0; i < geometries_.size(); ++i)
    if (geometries_[i] != nullptr) rtcDetachGeometry(handle_, i);
  std::vector<Range> ranges = std::move(ranges_);
  std::vector<RTCGeometry> geometries = std::move(geometries_);
  std::vector<RayInstance> instances = std::move(instances_);
  std::uint32_t total = 0;
  ranges_.assign(wanted.batches.size(), {});
  for (std::size_t i = 0; i < ranges_.size(); ++i) {
    const auto n = static_cast<std::uint32_t>(wanted.batches[i].frames.front()->instances.size());
    ranges_[i].first = total;
    ranges_[i].room = n;
    total += n;
  }
  geometries_.assign(total, nullptr);
  instances_.assign(total, {});
  std::vector<std::size_t> fresh;
  for (std::size_t i = 0; i < ranges_.size(); ++i) {
    const auto it = old.find(wanted.batches[i].frames.front()->serial);
    if (it == old.end() || !ranges[it->second].is(wanted.batches[i])) {
      fresh.push_back(i);
      continue;
    }
    Range& from = ranges[it->second];
    const std::uint32_t first = ranges_[i].first, room = ranges_[i].room, begin = from.first;
    std::copy_n(instances.begin() + begin, from.count, instances_.begin() + first);
    for (std::uint32_t k = 0; k < from.count; ++k)
      geometries_[first + k] = std::exchange(geometries[begin + k], nullptr);
    ranges_[i] = std::move(from);
    ranges_[i].first = first;
    ranges_[i].room = room;
    old.erase(it);
  }
  for (const auto& [serial, i] : old)
    for (std::uint32_t k = ranges[i].first; k < ranges[i].first + ranges[i].count; ++k)
      if (instances[k].motion != kStill) {
        motions_[instances[k].motion].poses.clear();
        free_motions_.push_back(instances[k].motion);
      }
  for (RTCGeometry g : geometries)
    if (g != nullptr) rtcReleaseGeometry(g);
  for (const std::size_t i : fresh) fill(wanted.batches[i], ranges_[i]);
  for (std::uint32_t i = 0; i < geometries_.size(); ++i)
    if (geometries_[i] != nullptr) rtcAttachGeometryByID(handle_, geometries_[i], i);
}

Status PlacedScene::place(const WantedContent& wanted) {
  const ContentFrame& frame = wanted.window->first();
  weather_.wetness = std::isfinite(frame.surface.wetness) ? std::clamp(frame.surface.wetness, 0.0F, 1.0F) : 0;
  weather_.snow_depth_m =
      std::isfinite(frame.surface.snow_depth_m) ? std::max(frame.surface.snow_depth_m, 0.0F) : 0;
  for (int k = 0; k < 3; ++k)
    weather_.cell[k] = static_cast<float>(origin_[k] - std::floor(origin_[k] / 1024) * 1024);

  bool in_place = ranges_.size() == wanted.batches.size();
  for (std::size_t i = 0; i < ranges_.size() && in_place; ++i)
    in_place = wanted.batches[i].frames.front()->instances.size() <= ranges_[i].room;
  if (in_place) {
    for (std::size_t i = 0; i < ranges_.size(); ++i) {
      Range& r = ranges_[i];
      if (r.is(wanted.batches[i])) continue;
      clear(r);
      fill(wanted.batches[i], r);
      for (std::uint32_t k = r.first; k < r.first + r.count; ++k)
        if (geometries_[k] != nullptr) rtcAttachGeometryByID(handle_, geometries_[k], k);
    }
  } else {
    number_anew(wanted);
  }
  rtcCommitScene(handle_);
  count_ = left_out_ = 0;
  for (const Range& r : ranges_) left_out_ += r.left_out;
  for (RTCGeometry g : geometries_) count_ += g != nullptr ? 1 : 0;
  if (const std::string c = cache_->complaint(); !c.empty()) return fail(ErrorCode::unavailable, "embree", c);
  return {};
}

}  // namespace rigor::render
