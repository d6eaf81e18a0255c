// Trees of boxes for trunks and alpha-tested quads for leaves, on rolling ground: content for tests and
// benches.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor-hal/models/philox.h"
#include "sim/render/content/content.h"

namespace rigor::test {

struct SyntheticForest {
  std::vector<std::shared_ptr<const render::Prototype>> kinds;
  std::shared_ptr<const render::Batch> ground;
  std::vector<std::shared_ptr<const render::Batch>> trees;
};

namespace forest_detail {
inline double draw(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  return (models::philox({a, b, c, 0}, {0x54726565U, 7U})[0] + 0.5) / 4294967296.0;
}
inline float ground_z(double x, double y) {
  return static_cast<float>(2.5 * std::sin(x / 31) * std::cos(y / 43) + 0.4 * std::sin(x / 7 + y / 9));
}
inline std::shared_ptr<render::Texture> leaf_texture() {
  auto t = std::make_shared<render::Texture>();
  t->width = t->height = 64;
  t->rgba.resize(64 * 64 * 4);
  for (std::uint32_t y = 0; y < 64; ++y)
    for (std::uint32_t x = 0; x < 64; ++x) {
      double inside = 0;
      for (std::uint32_t k = 0; k < 14; ++k) {
        const double cx = 6 + 52 * draw(k, 1, 0), cy = 6 + 52 * draw(k, 2, 0), a = 3.14159 * draw(k, 3, 0);
        const double dx = x - cx, dy = y - cy, u = dx * std::cos(a) + dy * std::sin(a),
                     v = dy * std::cos(a) - dx * std::sin(a);
        inside = std::max(inside, 1.2 - std::sqrt(u * u / 64 + v * v / 9));
      }
      auto* p = &t->rgba[(y * 64 + x) * 4];
      p[0] = static_cast<std::uint8_t>(70 + 30 * draw(x, y, 5));
      p[1] = static_cast<std::uint8_t>(110 + 40 * draw(x, y, 6));
      p[2] = 40;
      p[3] = static_cast<std::uint8_t>(std::clamp(inside * 2, 0.0, 1.0) * 255);
    }
  return t;
}
inline void quad(render::Mesh& m, const Eigen::Vector3f& c, const Eigen::Vector3f& u,
                 const Eigen::Vector3f& v, const Eigen::Vector3f& n, float sway) {
  const auto first = static_cast<std::uint32_t>(m.vertices.size());
  const float s[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
  for (const auto& k : s) {
    const Eigen::Vector3f p = c + k[0] * u + k[1] * v;
    m.vertices.push_back(
        {{p.x(), p.y(), p.z()}, {n.x(), n.y(), n.z()}, {0.5F + 0.5F * k[0], 0.5F - 0.5F * k[1]}, sway});
    m.bounds.extend(p);
  }
  for (const std::uint32_t k : {0U, 1U, 2U, 0U, 2U, 3U}) m.indices.push_back(first + k);
}
/// A trunk of `sides` and a crown of `leaves` quads, 10 m high.
inline std::shared_ptr<render::Mesh> tree(std::uint32_t kind, int sides, int leaves,
                                          const std::shared_ptr<const render::Surface>& bark,
                                          const std::shared_ptr<const render::Surface>& leaf) {
  auto m = std::make_shared<render::Mesh>();
  const auto ring = [&](int k, float z, float r) {
    const float a = 6.2831853F * static_cast<float>(k) / static_cast<float>(sides);
    return Eigen::Vector3f(r * std::cos(a), r * std::sin(a), z);
  };
  for (int k = 0; k < sides; ++k) {
    const Eigen::Vector3f a = ring(k, 0, 0.2F), b = ring(k + 1, 0, 0.2F), c = ring(k + 1, 9, 0.03F),
                          d = ring(k, 9, 0.03F);
    const auto first = static_cast<std::uint32_t>(m->vertices.size());
    for (const auto& p : {a, b, c, d}) {
      const Eigen::Vector3f n = Eigen::Vector3f(p.x(), p.y(), 0).normalized();
      m->vertices.push_back({{p.x(), p.y(), p.z()}, {n.x(), n.y(), n.z()}, {0, 0}, p.z() / 10 * 0.3F});
    }
    for (const std::uint32_t q : {0U, 1U, 2U, 0U, 2U, 3U}) m->indices.push_back(first + q);
  }
  const auto trunk = static_cast<std::uint32_t>(m->indices.size());
  const float grow = std::sqrt(240.0F / static_cast<float>(leaves));
  for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(leaves); ++i) {
    const float z = 2.5F + 7.5F * static_cast<float>(draw(i, kind, 10)),
                a = 6.2831853F * static_cast<float>(draw(i, kind, 11));
    const float r = (10.3F - z) * 0.32F * std::sqrt(static_cast<float>(draw(i, kind, 12)));
    const Eigen::Vector3f out(std::cos(a), std::sin(a), 0.25F);
    const Eigen::Vector3f u =
        Eigen::Vector3f(-std::sin(a), std::cos(a), 0.3F * static_cast<float>(draw(i, kind, 13)) - 0.15F)
            .normalized();
    const Eigen::Vector3f v = u.cross(out).normalized();
    quad(*m, {r * std::cos(a), r * std::sin(a), z}, u * 0.45F * grow, v * 0.45F * grow,
         (out + 0.6F * Eigen::Vector3f::UnitZ()).normalized(), z / 10);
  }
  m->parts = {{0, trunk, bark}, {trunk, static_cast<std::uint32_t>(m->indices.size()) - trunk, leaf}};
  return m;
}
}  // namespace forest_detail

/// `per_batch` trees in each batch; `side_m`: of the square.
inline SyntheticForest make_forest(std::size_t trees, double side_m, std::size_t per_batch) {
  using namespace forest_detail;
  SyntheticForest f;
  auto bark = std::make_shared<render::Surface>();
  bark->name = "bark";
  bark->reflectance = {0.16F, 0.12F, 0.09F, 0.3F, 0.32F, 0.35F};
  auto leaf = std::make_shared<render::Surface>();
  leaf->name = "leaves";
  leaf->reflectance = {0.35F, 0.55F, 0.3F, 0.48F, 0.48F, 0.3F};
  leaf->transmittance = {0.1F, 0.2F, 0.05F, 0.4F, 0.4F, 0.2F};
  leaf->colour_map = leaf_texture();
  leaf->alpha_cutoff = 0.5F;
  leaf->two_sided = true;
  for (std::uint32_t k = 0; k < 3; ++k) {
    auto p = std::make_shared<render::Prototype>();
    p->name = "tree";
    p->impostor = true;
    p->sway_m = 0.3F;
    p->levels = {{tree(k, 10, 240, bark, leaf), 0},
                 {tree(k, 5, 80, bark, leaf), 0.12F},
                 {tree(k, 3, 24, bark, leaf), 0.35F}};
    f.kinds.push_back(p);
  }
  auto soil = std::make_shared<render::Surface>();
  soil->reflectance = {0.2F, 0.17F, 0.1F, 0.3F, 0.32F, 0.35F};
  auto g = std::make_shared<render::Mesh>();
  constexpr int kCells = 64;
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) {
      const double x = (i - kCells / 2) * side_m / kCells, y = (j - kCells / 2) * side_m / kCells, h = 0.5;
      const Eigen::Vector3f n =
          Eigen::Vector3f(ground_z(x - h, y) - ground_z(x + h, y), ground_z(x, y - h) - ground_z(x, y + h), 1)
              .normalized();
      g->vertices.push_back(
          {{static_cast<float>(x), static_cast<float>(y), ground_z(x, y)}, {n.x(), n.y(), n.z()}, {0, 0}, 0});
    }
  for (std::uint32_t j = 0; j < kCells; ++j)
    for (std::uint32_t i = 0; i < kCells; ++i) {
      const std::uint32_t a = j * (kCells + 1) + i, b = a + kCells + 1;
      for (const std::uint32_t k : {a, a + 1, b + 1, a, b + 1, b}) g->indices.push_back(k);
    }
  g->parts = {{0, static_cast<std::uint32_t>(g->indices.size()), soil}};
  auto ground_kind = std::make_shared<render::Prototype>();
  ground_kind->levels = {{g, 0}};
  ground_kind->occludes = true;
  auto ground = std::make_shared<render::Batch>();
  ground->prototype = ground_kind;
  ground->instances.resize(1);
  ground->node = render::NodeId{1};
  f.ground = ground;
  // In cells, so that batches are small in space.
  const auto cells = static_cast<std::size_t>(
      std::max(1.0, std::round(std::sqrt(static_cast<double>(trees) / static_cast<double>(per_batch)))));
  std::vector<std::array<std::shared_ptr<render::Batch>, 3>> all(cells * cells);
  for (std::uint32_t i = 0; i < trees; ++i) {
    const double x = (draw(i, 0, 20) - 0.5) * side_m, y = (draw(i, 1, 20) - 0.5) * side_m;
    const auto cell = [&](double v) {
      return std::min(cells - 1, static_cast<std::size_t>((v / side_m + 0.5) * static_cast<double>(cells)));
    };
    const auto kind = static_cast<std::size_t>(3 * draw(i, 2, 20));
    auto& b = all[cell(y) * cells + cell(x)][kind];
    if (!b) {
      b = std::make_shared<render::Batch>();
      b->prototype = f.kinds[kind];
      b->origin = {(static_cast<double>(cell(x)) + 0.5) / static_cast<double>(cells) * side_m - 0.5 * side_m,
                   (static_cast<double>(cell(y)) + 0.5) / static_cast<double>(cells) * side_m - 0.5 * side_m,
                   0};
    }
    render::Instance t;
    t.position[0] = static_cast<float>(x - b->origin.x());
    t.position[1] = static_cast<float>(y - b->origin.y());
    t.position[2] = ground_z(x, y);
    const double a = 3.14159265 * draw(i, 3, 20);
    t.rotation[2] = static_cast<float>(std::sin(a));
    t.rotation[3] = static_cast<float>(std::cos(a));
    const auto s = static_cast<float>(0.8 + 1.2 * draw(i, 4, 20));
    t.scale[0] = t.scale[1] = t.scale[2] = s;
    t.tint[0] = t.tint[1] = t.tint[2] = static_cast<float>(0.8 + 0.3 * draw(i, 5, 20));
    t.phase = static_cast<float>(6.28 * draw(i, 6, 20));
    b->instances.push_back(t);
    b->nodes.push_back(render::NodeId{i + 2});
  }
  for (auto& cell : all)
    for (auto& b : cell)
      if (b) f.trees.push_back(b);
  return f;
}

}  // namespace rigor::test
