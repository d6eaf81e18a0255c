#include "sim/render/view/resident_content.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rigor::render {
namespace {

bool finite(const float* v, int n) {
  for (int i = 0; i < n; ++i)
    if (!std::isfinite(v[i])) return false;
  return true;
}

/// As the device keeps it; false where it cannot be drawn.
bool convert(const Instance& a, const Prototype& p, view_gpu::InstanceData& out) {
  const float length = std::sqrt(a.rotation[0] * a.rotation[0] + a.rotation[1] * a.rotation[1] +
                                 a.rotation[2] * a.rotation[2] + a.rotation[3] * a.rotation[3]);
  if (!finite(a.position, 3) || !finite(a.scale, 3) || !finite(a.tint, 3) || !std::isfinite(a.phase) ||
      !std::isfinite(length) || !(length > 1e-6F))
    return false;
  const float largest = std::max({std::abs(a.scale[0]), std::abs(a.scale[1]), std::abs(a.scale[2])});
  const float k = 1.0F / length;
  out.position = {a.position[0], a.position[1], a.position[2], a.phase};
  out.rotation = {a.rotation[0] * k, a.rotation[1] * k, a.rotation[2] * k, a.rotation[3] * k};
  out.scale = {a.scale[0], a.scale[1], a.scale[2], p.sway_m * largest};
  out.tint = {a.tint[0], a.tint[1], a.tint[2], 0};
  return true;
}

CullSphere sphere_of(const view_gpu::InstanceData& a, const ResidentPrototype& p) {
  const Eigen::Quaternionf q(a.rotation.w, a.rotation.x, a.rotation.y, a.rotation.z);
  const Eigen::Vector3f scale(a.scale.x, a.scale.y, a.scale.z);
  const Eigen::Vector3f c =
      Eigen::Vector3f(a.position.x, a.position.y, a.position.z) + q * scale.cwiseProduct(p.centre);
  return {c.x(), c.y(), c.z(), p.radius * scale.cwiseAbs().maxCoeff()};
}

/// Lowest and highest place of the prototype's box in an instance.
std::pair<float, float> heights_of(const view_gpu::InstanceData& a, const ResidentPrototype& p) {
  if (p.bounds.isEmpty()) return {a.position.z, a.position.z};
  const Eigen::Quaternionf q(a.rotation.w, a.rotation.x, a.rotation.y, a.rotation.z);
  const Eigen::Vector3f scale(a.scale.x, a.scale.y, a.scale.z);
  const Eigen::Vector3f up = scale.cwiseProduct(q.conjugate() * Eigen::Vector3f::UnitZ());
  const float middle = a.position.z + up.dot(p.bounds.center());
  const float half = 0.5F * up.cwiseAbs().dot(p.bounds.sizes());
  return {middle - half, middle + half};
}

}  // namespace

ResidentContent::ResidentContent(const Device::Impl& gpu, TexturePool& textures)
    : textures_(textures),
      geometry_(gpu, {.block_bytes = 16u << 20,
                      .usage = VK_BUFFER_USAGE_VERTEX_BUFFER_BIT | VK_BUFFER_USAGE_INDEX_BUFFER_BIT,
                      .alignment = 64}),
      instances_(gpu, {.block_bytes = std::min<std::size_t>(16u << 20, gpu.limits.maxStorageBufferRange),
                       .usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT,
                       .alignment = sizeof(view_gpu::InstanceData)}) {}

Result<const ResidentMesh*> ResidentContent::mesh(const std::shared_ptr<const Mesh>& m, std::uint64_t frame) {
  auto& slot = meshes_[m->serial];
  if (slot && slot->last_seen == frame) return slot.get();
  if (slot) {
    slot->last_seen = frame;
    for (std::size_t i = 0; i < slot->parts.size(); ++i) {
      auto s = textures_.get(slot->parts[i].surface->surface, frame);
      if (!s) return tl::unexpected(s.error());
    }
    return slot.get();
  }
  auto made = std::make_unique<ResidentMesh>();
  made->mesh = m;
  made->last_seen = frame;
  const auto drop = [&](const Error& e) -> Result<const ResidentMesh*> {
    meshes_.erase(m->serial);
    return tl::unexpected(e);
  };
  for (const Vertex& v : m->vertices)
    if (finite(v.position, 3)) made->bounds.extend(Eigen::Map<const Eigen::Vector3f>(v.position));
  const auto add = [&](std::uint32_t first, std::uint32_t count,
                       const std::shared_ptr<const Surface>& surface) -> Status {
    if (first > m->indices.size() || count > m->indices.size() - first || count < 3) return {};
    const auto begin = m->indices.begin() + first;
    if (std::any_of(begin, begin + count, [&](std::uint32_t i) { return i >= m->vertices.size(); }))
      return {};
    auto s = textures_.get(surface, frame);
    if (!s) return tl::unexpected(s.error());
    made->parts.push_back({first, count / 3 * 3, *s});
    made->triangles += count / 3;
    return {};
  };
  for (const MeshPart& part : m->parts)
    if (auto s = add(part.first_index, part.index_count, part.surface); !s) return drop(s.error());
  if (!made->parts.empty()) {
    const std::size_t vertex_bytes = m->vertices.size() * sizeof(Vertex), index_bytes = m->indices.size() * 4;
    auto vertices = geometry_.take(vertex_bytes);
    if (!vertices) return drop(vertices.error());
    made->vertices = *vertices;
    auto indices = geometry_.take(index_bytes);
    if (!indices) {
      geometry_.give(made->vertices);
      return drop(indices.error());
    }
    made->indices = *indices;
    std::memcpy(made->vertices.data, m->vertices.data(), vertex_bytes);
    std::memcpy(made->indices.data, m->indices.data(), index_bytes);
    uploaded_bytes_ += vertex_bytes + index_bytes;
  }
  slot = std::move(made);
  return slot.get();
}

Result<const ResidentPrototype*> ResidentContent::prototype(const std::shared_ptr<const Prototype>& p,
                                                            std::uint64_t frame) {
  auto& slot = prototypes_[p->serial];
  if (slot && slot->last_seen == frame) return slot.get();
  auto made = slot ? std::move(slot) : std::make_unique<ResidentPrototype>();
  const bool fresh = made->prototype == nullptr;
  made->prototype = p;
  made->last_seen = frame;
  made->levels.clear();
  for (const LevelOfDetail& level : p->levels) {
    const ResidentMesh* m = nullptr;
    if (level.mesh) {
      auto got = mesh(level.mesh, frame);
      if (!got) {
        prototypes_.erase(p->serial);
        return tl::unexpected(got.error());
      }
      m = *got;
    }
    made->levels.push_back(m);
    if (m != nullptr)
      for (const ResidentPart& part : m->parts)
        made->leaves = made->leaves || (part.surface->features & kFeatureTranslucent) != 0;
    if (fresh && m != nullptr && !m->bounds.isEmpty()) made->bounds.extend(m->bounds);
  }
  if (fresh && !made->bounds.isEmpty()) {
    made->centre = made->bounds.center();
    // The smallest sphere about that centre, by the vertices themselves.
    float r2 = 0;
    for (const ResidentMesh* m : made->levels)
      if (m != nullptr)
        for (const Vertex& v : m->mesh->vertices)
          if (finite(v.position, 3))
            r2 = std::max(r2, (Eigen::Map<const Eigen::Vector3f>(v.position) - made->centre).squaredNorm());
    made->radius = std::sqrt(r2) * 1.0001F + 1e-6F;
  }
  slot = std::move(made);
  return slot.get();
}

Result<const ResidentBatch*> ResidentContent::get(const std::shared_ptr<const Batch>& b,
                                                  std::uint64_t frame) {
  const ResidentBatch* const nothing = nullptr;
  if (!b || !b->prototype || b->instances.empty() || !b->origin.allFinite()) return nothing;
  auto p = prototype(b->prototype, frame);
  if (!p) return tl::unexpected(p.error());
  auto& slot = batches_[b->serial];
  if (slot) {
    slot->last_seen = frame;
    return slot.get();
  }
  auto made = std::make_unique<ResidentBatch>();
  made->batch = b;
  made->prototype = *p;
  made->last_seen = frame;
  std::vector<view_gpu::InstanceData> data;
  data.reserve(b->instances.size());
  made->spheres.reserve(b->instances.size());
  Eigen::AlignedBox3f box;
  for (std::uint32_t i = 0; i < b->instances.size(); ++i) {
    view_gpu::InstanceData d;
    if (!convert(b->instances[i], *b->prototype, d)) {
      if (made->source.empty())
        for (std::uint32_t k = 0; k < data.size(); ++k) made->source.push_back(k);
      ++made->skipped;
      continue;
    }
    if (made->skipped > 0) made->source.push_back(i);
    data.push_back(d);
    const CullSphere s = sphere_of(d, **p);
    made->spheres.push_back(s);
    const auto [low, high] = heights_of(d, **p);
    made->low_m = made->spheres.size() == 1 ? low : std::min(made->low_m, low);
    made->high_m = made->spheres.size() == 1 ? high : std::max(made->high_m, high);
    box.extend(Eigen::Vector3f(s.x - s.radius, s.y - s.radius, s.z - s.radius));
    box.extend(Eigen::Vector3f(s.x + s.radius, s.y + s.radius, s.z + s.radius));
  }
  if (!data.empty()) {
    made->bounds =
        Eigen::AlignedBox3d(box.min().cast<double>() + b->origin, box.max().cast<double>() + b->origin);
    const std::size_t bytes = data.size() * sizeof data[0];
    auto slice = instances_.take(bytes);
    if (!slice) {
      batches_.erase(b->serial);
      return tl::unexpected(slice.error());
    }
    made->instances = *slice;
    made->first_slot = static_cast<std::uint32_t>(slice->offset / sizeof data[0]);
    std::memcpy(slice->data, data.data(), bytes);
    uploaded_bytes_ += bytes;
  }
  slot = std::move(made);
  return slot.get();
}

void ResidentContent::drop_older_than(std::uint64_t frame) {
  std::erase_if(batches_, [&](auto& e) {
    if (e.second->last_seen >= frame) return false;
    instances_.give(e.second->instances);
    return true;
  });
  std::erase_if(prototypes_, [&](const auto& e) { return e.second->last_seen < frame; });
  std::erase_if(meshes_, [&](auto& e) {
    if (e.second->last_seen >= frame) return false;
    geometry_.give(e.second->vertices);
    geometry_.give(e.second->indices);
    return true;
  });
}

}  // namespace rigor::render
