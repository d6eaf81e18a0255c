// Small worlds for the rays engine.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "sim/render/rays/embree_engine.h"

namespace rigor::test {

using namespace rigor::render;
using Eigen::Vector3d;
using Eigen::Vector3f;

inline Spectrum grey(float v) { return {v, v, v, v, v, v}; }
inline std::shared_ptr<Surface> surface_of(float reflectance) {
  auto s = std::make_shared<Surface>();
  s->reflectance = grey(reflectance);
  return s;
}

/// Corners anticlockwise from outside; (u, v) = (0, 1), (1, 1), (1, 0), (0, 0), so that v grows downwards.
inline void add_quad(Mesh& m, const Vector3f& a, const Vector3f& b, const Vector3f& c, const Vector3f& d) {
  const Vector3f n = (b - a).cross(d - a).normalized();
  const auto first = static_cast<std::uint32_t>(m.vertices.size());
  const Vector3f corners[4] = {a, b, c, d};
  const float uv[4][2] = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
  for (int i = 0; i < 4; ++i) {
    m.vertices.push_back(
        {{corners[i].x(), corners[i].y(), corners[i].z()}, {n.x(), n.y(), n.z()}, {uv[i][0], uv[i][1]}, 0});
    m.bounds.extend(corners[i]);
  }
  for (const std::uint32_t k : {0U, 1U, 2U, 0U, 2U, 3U}) m.indices.push_back(first + k);
}
inline std::shared_ptr<Mesh> finished(Mesh m, std::shared_ptr<const Surface> surface) {
  m.parts.push_back({0, static_cast<std::uint32_t>(m.indices.size()), std::move(surface)});
  return std::make_shared<Mesh>(std::move(m));
}
/// Level, seen from above; x east with u, y north against v.
inline std::shared_ptr<Mesh> plane_mesh(float half, std::shared_ptr<const Surface> s, float z = 0) {
  Mesh m;
  add_quad(m, {-half, -half, z}, {half, -half, z}, {half, half, z}, {-half, half, z});
  return finished(std::move(m), std::move(s));
}
inline std::shared_ptr<Mesh> box_mesh(const Vector3f& h, std::shared_ptr<const Surface> s) {
  Mesh m;
  const auto p = [&](int x, int y, int z) {
    return Vector3f(h.cwiseProduct(Eigen::Vector3i(x, y, z).cast<float>()));
  };
  add_quad(m, p(1, -1, -1), p(1, 1, -1), p(1, 1, 1), p(1, -1, 1));
  add_quad(m, p(-1, 1, -1), p(-1, -1, -1), p(-1, -1, 1), p(-1, 1, 1));
  add_quad(m, p(1, 1, -1), p(-1, 1, -1), p(-1, 1, 1), p(1, 1, 1));
  add_quad(m, p(-1, -1, -1), p(1, -1, -1), p(1, -1, 1), p(-1, -1, 1));
  add_quad(m, p(-1, -1, 1), p(1, -1, 1), p(1, 1, 1), p(-1, 1, 1));
  add_quad(m, p(-1, 1, -1), p(1, 1, -1), p(1, -1, -1), p(-1, -1, -1));
  return finished(std::move(m), std::move(s));
}
inline std::shared_ptr<Prototype> prototype_of(std::shared_ptr<const Mesh> mesh) {
  auto p = std::make_shared<Prototype>();
  p->levels.push_back({std::move(mesh), 0});
  return p;
}
inline Instance at(float x, float y, float z) {
  Instance i;
  i.position[0] = x;
  i.position[1] = y;
  i.position[2] = z;
  return i;
}
inline void turn(Instance& i, const Eigen::Quaternionf& q) {
  i.rotation[0] = q.x();
  i.rotation[1] = q.y();
  i.rotation[2] = q.z();
  i.rotation[3] = q.w();
}
inline std::shared_ptr<Batch> batch_of(std::shared_ptr<const Prototype> p, std::vector<Instance> instances,
                                       std::uint64_t node = 0, const Vector3d& origin = Vector3d::Zero()) {
  auto b = std::make_shared<Batch>();
  b->prototype = std::move(p);
  b->instances = std::move(instances);
  b->origin = origin;
  b->node = NodeId{node};
  return b;
}
inline std::shared_ptr<Batch> one(std::shared_ptr<const Mesh> mesh, std::uint64_t node,
                                  const Vector3d& origin = Vector3d::Zero()) {
  return batch_of(prototype_of(std::move(mesh)), {at(0, 0, 0)}, node, origin);
}

inline std::shared_ptr<ContentWindow> window_of(std::vector<ContentFrame> frames) {
  auto w = std::make_shared<ContentWindow>();
  w->end = w->begin + milliseconds(100);
  for (ContentFrame& f : frames) w->frames.push_back(std::make_shared<const ContentFrame>(std::move(f)));
  return w;
}
inline std::shared_ptr<ContentWindow> window_of(std::vector<std::shared_ptr<const Batch>> batches) {
  ContentFrame f;
  f.batches = std::move(batches);
  return window_of(std::vector<ContentFrame>{std::move(f)});
}

inline Ray ray_of(const Vector3d& origin, const Vector3d& direction, float time = 0) {
  const Vector3d d = direction.normalized();
  Ray r;
  for (int k = 0; k < 3; ++k) {
    r.origin[k] = static_cast<float>(origin[k]);
    r.direction[k] = static_cast<float>(d[k]);
  }
  r.time = time;
  return r;
}
inline Vector3f normal_of(const Hit& h) { return Eigen::Map<const Vector3f>(h.normal); }

class RaysTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto cache = EmbreeCache::create();
    ASSERT_TRUE(cache) << cache.error().text();
    cache_ = *cache;
    engine_ = make();
  }
  std::shared_ptr<EmbreeEngine> make(const EmbreeOptions& options = {}) {
    auto e = EmbreeEngine::create(cache_, options);
    EXPECT_TRUE(e) << e.error().text();
    return *e;
  }
  void show(std::vector<std::shared_ptr<const Batch>> batches) { show(window_of(std::move(batches))); }
  void show(std::shared_ptr<const ContentWindow> window) {
    const Status s = engine_->prepare(std::move(window));
    ASSERT_TRUE(s) << s.error().text();
  }
  std::vector<Hit> cast(const std::vector<Ray>& rays, const Vector3d& origin = Vector3d::Zero(),
                        int band = 4) {
    return cast(*engine_, rays, origin, band);
  }
  static std::vector<Hit> cast(EmbreeEngine& engine, const std::vector<Ray>& rays,
                               const Vector3d& origin = Vector3d::Zero(), int band = 4) {
    std::vector<Hit> hits(rays.size());
    const Status s = engine.cast({.origin = origin, .band = band, .rays = rays}, hits);
    EXPECT_TRUE(s) << s.error().text();
    return hits;
  }
  Hit shoot(const Vector3d& from, const Vector3d& direction, float time = 0, int band = 4) {
    return cast({ray_of(from, direction, time)}, Vector3d::Zero(), band)[0];
  }

  std::shared_ptr<EmbreeCache> cache_;
  std::shared_ptr<EmbreeEngine> engine_;
};

}  // namespace rigor::test
