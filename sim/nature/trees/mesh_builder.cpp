#include "sim/nature/trees/mesh_builder.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace rigor::nature {
namespace {
constexpr float kTwoPi = 2 * std::numbers::pi_v<float>;
}

std::uint32_t MeshBuilder::vertex(const Vec3& p, const Vec3& n, float u, float v, float sway) {
  vertices_.push_back({{p.x(), p.y(), p.z()}, {n.x(), n.y(), n.z()}, {u, v}, sway});
  return static_cast<std::uint32_t>(vertices_.size() - 1);
}
std::uint32_t MeshBuilder::wood_vertex(const Vec3& p, const Vec3& n, float u, float v, float sway) {
  return vertex(p, n, u, v, sway);
}
void MeshBuilder::wood_triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  wood_.insert(wood_.end(), {a, b, c});
}

void MeshBuilder::tube(std::span<const StemPoint> path, int sides, float bark_repeats, float v_m) {
  const std::size_t n = path.size();
  Vec3 side = Vec3::Zero();
  std::vector<std::uint32_t> previous;
  float v = v_m / kBarkHeight_m;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3 ahead =
        (path[std::min(i + 1, n - 1)].position - path[i > 0 ? i - 1 : 0].position).normalized();
    side = i == 0 ? square_to(ahead) : Vec3((side - side.dot(ahead) * ahead).normalized());
    const Vec3 other = ahead.cross(side);
    if (i > 0) v += (path[i].position - path[i - 1].position).norm() / kBarkHeight_m;
    std::vector<std::uint32_t> ring;
    const bool tip = i + 1 == n && path[i].radius <= 0;
    const int count = tip ? sides : sides + 1;
    for (int k = 0; k < count; ++k) {
      const float f = (static_cast<float>(k) + (tip ? 0.5F : 0.0F)) / static_cast<float>(sides),
                  a = kTwoPi * f;
      const Vec3 out = std::cos(a) * side + std::sin(a) * other;
      ring.push_back(vertex(path[i].position + path[i].radius * out, out, f * bark_repeats, v, path[i].sway));
    }
    if (i > 0)
      for (int k = 0; k < sides; ++k) {
        if (tip) {
          wood_triangle(previous[k], previous[k + 1], ring[k]);
        } else {
          wood_triangle(previous[k], previous[k + 1], ring[k + 1]);
          wood_triangle(previous[k], ring[k + 1], ring[k]);
        }
      }
    previous = std::move(ring);
  }
}

void MeshBuilder::card(const Vec3& base, const Vec3& along, const Vec3& up, float half_width, int cell,
                       const Vec3& normal_base, const Vec3& normal_tip, float sway_base, float sway_tip,
                       float part) {
  AtlasCell c = atlas_cell(cell);
  const float middle = 0.5F * (c.u0 + c.u1), half = 0.5F * part * (c.u1 - c.u0);
  c = {middle - half, c.v0, middle + half, c.v0 + part * (c.v1 - c.v0)};
  Vec3 side = along.cross(up);
  if (side.squaredNorm() < 1e-12F) side = square_to(along);
  side = side.normalized() * half_width;
  const std::uint32_t a = vertex(base - side, normal_base, c.u0, c.v1, sway_base);
  const std::uint32_t b = vertex(base + side, normal_base, c.u1, c.v1, sway_base);
  const std::uint32_t d = vertex(base + along + side, normal_tip, c.u1, c.v0, sway_tip);
  const std::uint32_t e = vertex(base + along - side, normal_tip, c.u0, c.v0, sway_tip);
  auto& triangles = inner_now_ ? inner_ : foliage_;
  triangles.insert(triangles.end(), {a, b, d, a, d, e});
  const float area = 2 * half_width * along.norm();
  leaf_area_m2_ += area * coverage_[cell];
  flat_area_m2_ += area, flat_moment_m3_ += area * half_width;
}

void MeshBuilder::bough(std::span<const BoughPoint> path, float fold_rad, int cell, bool mirrored) {
  AtlasCell c = atlas_cell(cell);
  if (mirrored) std::swap(c.u0, c.u1);
  const float middle = 0.5F * (c.u0 + c.u1);
  float length = 0;
  for (std::size_t i = 1; i < path.size(); ++i) length += (path[i].position - path[i - 1].position).norm();
  float gone = 0;
  std::uint32_t last[3] = {};
  for (std::size_t i = 0; i < path.size(); ++i) {
    const BoughPoint& p = path[i];
    float step = 0;
    if (i > 0) step = (p.position - path[i - 1].position).norm();
    gone += step;
    const float v = c.v1 + (c.v0 - c.v1) * gone / length;
    const Vec3 out = std::cos(fold_rad) * p.side * p.half_width,
               down = -std::sin(fold_rad) * p.up * p.half_width;
    const Vec3 tilt = 0.35F * std::sin(fold_rad) * p.side;
    const std::uint32_t now[3] = {
        vertex(p.position - out + down, (p.normal - tilt).normalized(), c.u0, v, p.sway),
        vertex(p.position, p.normal, middle, v, p.sway),
        vertex(p.position + out + down, (p.normal + tilt).normalized(), c.u1, v, p.sway)};
    if (i > 0) {
      // The first of several pieces is next to the trunk.
      auto& triangles = inner_now_ || (i == 1 && path.size() > 2) ? inner_ : foliage_;
      for (int k = 0; k < 2; ++k)
        triangles.insert(triangles.end(), {last[k], last[k + 1], now[k + 1], last[k], now[k + 1], now[k]});
      const float area = (p.half_width + path[i - 1].half_width) * step;
      leaf_area_m2_ += area * coverage_[cell];
      flat_area_m2_ += area, flat_moment_m3_ += area * p.half_width;
    }
    std::copy(std::begin(now), std::end(now), std::begin(last));
  }
}

std::shared_ptr<const render::Mesh> MeshBuilder::finish(std::shared_ptr<const render::Surface> wood,
                                                        std::shared_ptr<const render::Surface> foliage,
                                                        std::shared_ptr<const render::Surface> inner) {
  auto mesh = std::make_shared<render::Mesh>();
  mesh->vertices = std::move(vertices_);
  const auto part = [&](const std::vector<std::uint32_t>& indices,
                        std::shared_ptr<const render::Surface> surface) {
    if (indices.empty()) return;
    mesh->parts.push_back({static_cast<std::uint32_t>(mesh->indices.size()),
                           static_cast<std::uint32_t>(indices.size()), std::move(surface)});
    mesh->indices.insert(mesh->indices.end(), indices.begin(), indices.end());
  };
  part(wood_, std::move(wood));
  part(inner_, inner ? std::move(inner) : foliage);
  part(foliage_, std::move(foliage));
  for (const render::Vertex& v : mesh->vertices)
    mesh->bounds.extend(Vec3(v.position[0], v.position[1], v.position[2]));
  return mesh;
}

}  // namespace rigor::nature
