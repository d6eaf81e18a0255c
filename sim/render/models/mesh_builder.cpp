#include "sim/render/models/mesh_builder.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace rigor::render {
namespace {
using Eigen::Vector2d;
using Eigen::Vector3d;

Vertex vertex(const Vector3d& p, const Vector3d& n, const Vector2d& uv) {
  Vertex v{};
  for (int i = 0; i < 3; ++i) {
    v.position[i] = static_cast<float>(p[i]);
    v.normal[i] = static_cast<float>(n[i]);
  }
  v.uv[0] = static_cast<float>(uv.x());
  v.uv[1] = static_cast<float>(uv.y());
  return v;
}
}  // namespace

MeshBuilder::Group& MeshBuilder::group(const SurfacePtr& surface) {
  const auto [at, fresh] = index_.try_emplace(surface.get(), groups_.size());
  if (fresh) groups_.push_back({.surface = surface, .vertices = {}, .indices = {}});
  return groups_[at->second];
}

void MeshBuilder::triangle(const SurfacePtr& surface, const Vector3d& a, const Vector3d& b, const Vector3d& c,
                           const PictureFrame& picture) {
  const Vector3d corners[] = {a, b, c};
  polygon(surface, corners, picture);
}

void MeshBuilder::polygon(const SurfacePtr& surface, std::span<const Vector3d> corners,
                          const PictureFrame& picture) {
  Vector3d n = Vector3d::Zero();
  for (std::size_t i = 1; i + 1 < corners.size(); ++i)
    n += (corners[i] - corners[0]).cross(corners[i + 1] - corners[0]);
  if (!(n.norm() > 1e-12)) return;
  n.normalize();
  Group& g = group(surface);
  const auto first = static_cast<std::uint32_t>(g.vertices.size());
  for (const Vector3d& p : corners) g.vertices.push_back(vertex(p, n, picture.at(p)));
  for (std::uint32_t i = 1; i + 1 < corners.size(); ++i) {
    const auto &p = corners[0], &q = corners[i], &r = corners[i + 1];
    if (!((q - p).cross(r - p).norm() > 1e-12)) continue;
    for (const std::uint32_t k : {0U, i, i + 1}) g.indices.push_back(first + k);
  }
}

void MeshBuilder::box(const SurfacePtr& surface, const Vector3d& min, const Vector3d& max, unsigned without) {
  for (int axis = 0; axis < 3; ++axis)
    for (const int side : {0, 1}) {
      if (without & (1U << (2 * axis + side))) continue;
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      Vector3d p[4];
      for (int k = 0; k < 4; ++k) {
        p[k][axis] = side ? max[axis] : min[axis];
        p[k][u] = (k == 1 || k == 2) ? max[u] : min[u];
        p[k][v] = k >= 2 ? max[v] : min[v];
      }
      if (!side) std::swap(p[1], p[3]);
      PictureFrame f;
      f.origin = min;
      if (axis == 0) f.right = Vector3d::UnitY();
      if (axis == 2) f.down = -Vector3d::UnitY();
      polygon(surface, p, f);
    }
}

void MeshBuilder::cylinder(const SurfacePtr& surface, const Round& r) {
  Group& g = group(surface);
  const auto first = static_cast<std::uint32_t>(g.vertices.size());
  const auto n = static_cast<std::uint32_t>(r.segments);
  const double slope = (r.radius0_m - r.radius1_m) / (r.z1_m - r.z0_m);
  const double around_m = 2 * std::numbers::pi * std::max(r.radius0_m, r.radius1_m);
  std::vector<Vector2d> unit;
  for (std::uint32_t i = 0; i <= n; ++i) {
    const double a = 2 * std::numbers::pi * (i % n) / n;
    unit.emplace_back(std::cos(a), std::sin(a));
    const Vector3d normal = Vector3d(unit[i].x(), unit[i].y(), slope).normalized();
    const double u = around_m * i / n;
    g.vertices.push_back(
        vertex({unit[i].x() * r.radius0_m, unit[i].y() * r.radius0_m, r.z0_m}, normal, {u, -r.z0_m}));
    g.vertices.push_back(
        vertex({unit[i].x() * r.radius1_m, unit[i].y() * r.radius1_m, r.z1_m}, normal, {u, -r.z1_m}));
  }
  for (std::uint32_t i = 0; i < n; ++i)
    for (const std::uint32_t k : {2 * i, 2 * i + 2, 2 * i + 3, 2 * i, 2 * i + 3, 2 * i + 1})
      g.indices.push_back(first + k);
  for (const bool top : {false, true}) {
    const double radius = top ? r.radius1_m : r.radius0_m, z = top ? r.z1_m : r.z0_m;
    if (!(radius > 0)) continue;
    const auto at = static_cast<std::uint32_t>(g.vertices.size());
    for (std::uint32_t i = 0; i < n; ++i)
      g.vertices.push_back(vertex({unit[i].x() * radius, unit[i].y() * radius, z}, {0, 0, top ? 1.0 : -1.0},
                                  {unit[i].x() * radius, -unit[i].y() * radius}));
    for (std::uint32_t i = 1; i + 1 < n; ++i)
      for (const std::uint32_t k : {0U, top ? i : i + 1, top ? i + 1 : i}) g.indices.push_back(at + k);
  }
}

void MeshBuilder::append(const SurfacePtr& surface, std::span<const Vertex> vertices,
                         std::span<const std::uint32_t> indices) {
  Group& g = group(surface);
  const auto first = static_cast<std::uint32_t>(g.vertices.size());
  g.vertices.insert(g.vertices.end(), vertices.begin(), vertices.end());
  for (const std::uint32_t i : indices) g.indices.push_back(first + i);
}

std::size_t MeshBuilder::triangle_count() const noexcept {
  std::size_t n = 0;
  for (const Group& g : groups_) n += g.indices.size() / 3;
  return n;
}

std::shared_ptr<const Mesh> MeshBuilder::finish() const {
  auto mesh = std::make_shared<Mesh>();
  std::size_t vertices = 0, indices = 0;
  for (const Group& g : groups_) {
    vertices += g.vertices.size();
    indices += g.indices.size();
  }
  mesh->vertices.reserve(vertices);
  mesh->indices.reserve(indices);
  for (const Group& g : groups_) {
    const auto first = static_cast<std::uint32_t>(mesh->vertices.size());
    mesh->parts.push_back({.first_index = static_cast<std::uint32_t>(mesh->indices.size()),
                           .index_count = static_cast<std::uint32_t>(g.indices.size()),
                           .surface = g.surface});
    mesh->vertices.insert(mesh->vertices.end(), g.vertices.begin(), g.vertices.end());
    for (const std::uint32_t i : g.indices) mesh->indices.push_back(first + i);
  }
  for (const Vertex& v : mesh->vertices)
    mesh->bounds.extend(Eigen::Vector3f(v.position[0], v.position[1], v.position[2]));
  return mesh;
}

Eigen::AlignedBox3d bounds_of(const Batch& batch) {
  Eigen::AlignedBox3d all;
  const Eigen::AlignedBox3f& own = batch.prototype->levels.front().mesh->bounds;
  if (own.isEmpty()) return all;
  for (const Instance& i : batch.instances) {
    const Eigen::Quaterniond q(i.rotation[3], i.rotation[0], i.rotation[1], i.rotation[2]);
    const Vector3d at = batch.origin + Vector3d(i.position[0], i.position[1], i.position[2]);
    const Vector3d scale(i.scale[0], i.scale[1], i.scale[2]);
    for (int k = 0; k < 8; ++k) {
      const Vector3d corner =
          own.corner(static_cast<Eigen::AlignedBox3f::CornerType>(k)).cast<double>().cwiseProduct(scale);
      all.extend(at + q * corner);
    }
  }
  return all;
}

std::shared_ptr<const Batch> single_batch(std::string name, NodeId node, const Vector3d& origin,
                                          std::vector<LevelOfDetail> levels, bool occludes) {
  auto prototype = std::make_shared<Prototype>();
  prototype->name = std::move(name);
  prototype->levels = std::move(levels);
  prototype->occludes = occludes;
  auto batch = std::make_shared<Batch>();
  batch->prototype = std::move(prototype);
  batch->origin = origin;
  batch->instances.emplace_back();
  batch->node = node;
  batch->bounds = bounds_of(*batch);
  return batch;
}

Instance instance_at(const Eigen::Isometry3d& T_world_instance, const Vector3d& origin) {
  Instance out;
  const Vector3d p = T_world_instance.translation() - origin;
  Eigen::Quaterniond q(T_world_instance.linear());
  q.normalize();
  for (int i = 0; i < 3; ++i) out.position[i] = static_cast<float>(p[i]);
  const double xyzw[] = {q.x(), q.y(), q.z(), q.w()};
  for (int i = 0; i < 4; ++i) out.rotation[i] = static_cast<float>(xyzw[i]);
  return out;
}

}  // namespace rigor::render
