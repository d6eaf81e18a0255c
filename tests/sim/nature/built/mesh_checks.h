// What a solid must fulfil, seen from its finished mesh alone.
#pragma once

#include <array>
#include <cmath>
#include <cstring>
#include <map>

#include "sim/render/content/content.h"

namespace rigor::test {

inline Eigen::Vector3d position(const render::Mesh& m, std::uint32_t index) {
  const auto& p = m.vertices[index].position;
  return {p[0], p[1], p[2]};
}

template <class Visit>  // void(a, b, c, surface)
void each_triangle(const render::Mesh& m, const Visit& visit) {
  for (const auto& part : m.parts)
    for (std::uint32_t i = part.first_index; i + 2 < part.first_index + part.index_count; i += 3)
      visit(m.indices[i], m.indices[i + 1], m.indices[i + 2], *part.surface);
}

/// Edges that are not run along as often one way as the other; points are one only where they are equal bit
/// by bit.
inline int open_edge_count(const render::Mesh& m) {
  using Key = std::array<float, 3>;
  std::map<std::pair<Key, Key>, int> balance;
  each_triangle(m, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface&) {
    const std::uint32_t v[] = {a, b, c};
    for (int k = 0; k < 3; ++k) {
      const auto key = [&](std::uint32_t i) -> Key {
        const auto& p = m.vertices[i].position;
        return {p[0] + 0.0F, p[1] + 0.0F, p[2] + 0.0F};
      };
      const Key from = key(v[k]), to = key(v[(k + 1) % 3]);
      if (from < to)
        ++balance[{from, to}];
      else
        --balance[{to, from}];
    }
  });
  int open = 0;
  for (const auto& [edge, n] : balance) open += n != 0;
  return open;
}

inline double volume_m3(const render::Mesh& m) {
  double six = 0;
  each_triangle(m, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface&) {
    six += position(m, a).dot(position(m, b).cross(position(m, c)));
  });
  return six / 6;
}

/// Area of all faces that pass the filter: bool(normal, surface).
template <class Filter>
double area_m2(const render::Mesh& m, const Filter& filter) {
  double sum = 0;
  each_triangle(m, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface& s) {
    const Eigen::Vector3d n = (position(m, b) - position(m, a)).cross(position(m, c) - position(m, a)) / 2;
    if (n.norm() > 0 && filter(Eigen::Vector3d(n.normalized()), s)) sum += n.norm();
  });
  return sum;
}

/// Least cosine between a face and the normals of its vertices.
inline double worst_normal(const render::Mesh& m) {
  double worst = 1;
  each_triangle(m, [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, const render::Surface&) {
    const Eigen::Vector3d n = (position(m, b) - position(m, a)).cross(position(m, c) - position(m, a));
    if (n.norm() < 1e-6) return;  // too small for its direction to survive float
    for (const auto i : {a, b, c}) {
      const auto& v = m.vertices[i].normal;
      worst = std::min(worst, n.normalized().dot(Eigen::Vector3d(v[0], v[1], v[2])));
    }
  });
  return worst;
}

}  // namespace rigor::test
