// An engine whose answers are known in closed form: planes, rectangles, spheres and boxes that stand still or
// move evenly, worked out in double. What simulators are tested against.
//
//   auto engine = std::make_shared<test::AnalyticEngine>();
//   engine->add(test::Plane{.point = {10, 0, 0}, .normal = {-1, 0, 0}}, {.reflectance = test::grey(0.5F)});
//   engine->add(test::Sphere{.centre = {5, 0, 0}, .radius_m = 1}, {.velocity_m_per_s = {0, 2, 0}});
//   test::AnalyticWorld world;                                    // frame with light, hazes, type names
//   simulator.capture(request, {world, pose}, …)
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "sim/render/engine/ray_engine.h"

namespace rigor::test {

/// Unbounded, seen from both sides.
struct Plane {
  Eigen::Vector3d point{0, 0, 0};
  Eigen::Vector3d normal{0, 0, 1};
};
/// Centre ± half_u ± half_v, the two at right angles; seen from both sides.
struct Rectangle {
  Eigen::Vector3d centre{0, 0, 0};
  Eigen::Vector3d half_u{0, 1, 0}, half_v{0, 0, 1};
};
struct Sphere {
  Eigen::Vector3d centre{0, 0, 0};
  double radius_m = 1;
};
struct Box {
  Eigen::Vector3d centre{0, 0, 0};
  Eigen::Vector3d half{0.5, 0.5, 0.5};
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
};
using Shape = std::variant<Plane, Rectangle, Sphere, Box>;

[[nodiscard]] inline render::Spectrum grey(float value) {
  render::Spectrum s{};
  s.fill(value);
  return s;
}

/// How a shape looks and moves.
struct Look {
  render::Spectrum reflectance = grey(0.5F);
  float roughness = 1, metallic = 0, retro_reflection = 0, transmittance = 0;
  bool water = false;
  world::NodeId node{};
  /// The shape's place is the one stated at `t_ref`, and goes on evenly from there.
  Eigen::Vector3d velocity_m_per_s{0, 0, 0};
  BenchTime t_ref{};
  /// Stands for maps: may change reflectance, roughness or normal (towards the ray's origin, unit length) of
  /// a hit at a point of the shape where it stood at t_ref. The incidence is worked out after it.
  std::function<void(render::Hit&, const Eigen::Vector3d& p_world, int band)> map{};
};

class AnalyticEngine final : public render::RayEngine {
 public:
  void add(const Shape& shape, Look look = {}) {
    auto surface = std::make_shared<render::Surface>();
    surface->reflectance = look.reflectance;
    surface->roughness = look.roughness;
    surface->metallic = look.metallic;
    surface->retro_reflection = look.retro_reflection;
    surface->transmittance = grey(look.transmittance);
    surface->water = look.water;
    things_.push_back({shape, std::move(look), std::move(surface)});
  }
  void clear() { things_.clear(); }

  [[nodiscard]] std::string_view name() const override { return "analytic"; }
  [[nodiscard]] Status prepare(std::shared_ptr<const render::ContentWindow> window) override {
    if (!window || window->frames.empty())
      return fail(ErrorCode::bad_input, "", "expected a window with frames");
    window_ = std::move(window);
    ++prepares;
    return {};
  }
  [[nodiscard]] Status cast(const render::RayQuery& query, std::span<render::Hit> hits) override {
    if (!window_) return fail(ErrorCode::bad_input, "", "nothing was prepared");
    if (hits.size() != query.rays.size()) return fail(ErrorCode::bad_input, "", "as many hits as rays");
    if (query.band < 0 || query.band >= render::kBandCount)
      return fail(ErrorCode::bad_input, "", "no such band");
    for (std::size_t i = 0; i < hits.size(); ++i) hits[i] = first_hit(query, query.rays[i]);
    rays_cast += hits.size();
    return {};
  }
  [[nodiscard]] Status cast_layers(const render::RayQuery& query, render::LayeredHits& hits) override {
    return RayEngine::cast_layers(query, hits);
  }
  [[nodiscard]] render::EngineStatistics statistics() const override {
    return {.instances = things_.size(), .prototypes = things_.size()};
  }
  [[nodiscard]] const render::ContentWindow* window() const { return window_.get(); }

  std::size_t prepares = 0, rays_cast = 0;  ///< how often it was asked

 private:
  struct Thing {
    Shape shape;
    Look look;
    std::shared_ptr<const render::Surface> surface;
  };
  struct Intersection {
    double range_m = std::numeric_limits<double>::infinity();
    Eigen::Vector3d normal{0, 0, 1};
  };

  static void keep(Intersection& best, double range_m, const Eigen::Vector3d& normal, double near_m,
                   double far_m) {
    if (range_m >= near_m && range_m <= far_m && range_m < best.range_m) best = {range_m, normal};
  }
  static Intersection intersect(const Plane& s, const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                                double near_m, double far_m) {
    Intersection m;
    const Eigen::Vector3d n = s.normal.normalized();
    const double across = d.dot(n);
    if (across != 0) keep(m, (s.point - o).dot(n) / across, n, near_m, far_m);
    return m;
  }
  static Intersection intersect(const Rectangle& s, const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                                double near_m, double far_m) {
    Intersection m = intersect(Plane{s.centre, s.half_u.cross(s.half_v)}, o, d, near_m, far_m);
    const Eigen::Vector3d p = o + d * m.range_m - s.centre;
    if (!(std::abs(p.dot(s.half_u)) <= s.half_u.squaredNorm() &&
          std::abs(p.dot(s.half_v)) <= s.half_v.squaredNorm()))
      return {};
    return m;
  }
  static Intersection intersect(const Sphere& s, const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                                double near_m, double far_m) {
    Intersection m;
    const Eigen::Vector3d c = o - s.centre;
    const double b = c.dot(d);
    // Distance of the line from the centre by the part of c across d: no cancellation far from the sphere.
    const double q = s.radius_m * s.radius_m - (c - b * d).squaredNorm();
    if (q < 0) return m;
    for (const double t : {-b - std::sqrt(q), -b + std::sqrt(q)})
      keep(m, t, (c + d * t) / s.radius_m, near_m, far_m);
    return m;
  }
  static Intersection intersect(const Box& s, const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                                double near_m, double far_m) {
    Intersection m;
    const Eigen::Vector3d oo = s.rotation.conjugate() * (o - s.centre), dd = s.rotation.conjugate() * d;
    for (int axis = 0; axis < 3; ++axis)
      for (const double side : {-1.0, 1.0}) {
        if (dd[axis] == 0) continue;
        const double t = (side * s.half[axis] - oo[axis]) / dd[axis];
        const Eigen::Vector3d p = oo + dd * t;
        const int a = (axis + 1) % 3, b = (axis + 2) % 3;
        if (std::abs(p[a]) <= s.half[a] && std::abs(p[b]) <= s.half[b])
          keep(m, t, s.rotation * (Eigen::Vector3d::Unit(axis) * side), near_m, far_m);
      }
    return m;
  }

  [[nodiscard]] render::Hit first_hit(const render::RayQuery& query, const render::Ray& ray) const {
    const Eigen::Vector3d d(ray.direction[0], ray.direction[1], ray.direction[2]);
    const Eigen::Vector3d o = query.origin + Eigen::Vector3d(ray.origin[0], ray.origin[1], ray.origin[2]);
    render::Hit hit;
    if (!d.allFinite() || !o.allFinite() || !std::isfinite(ray.time)) return hit;
    const double t_s = static_cast<double>(window_->begin.ns()) * 1e-9 +
                       static_cast<double>(ray.time) * (window_->end - window_->begin).seconds();
    Intersection best;
    const Thing* met = nullptr;
    Eigen::Vector3d shift = Eigen::Vector3d::Zero();
    for (const Thing& thing : things_) {
      const Eigen::Vector3d moved =
          thing.look.velocity_m_per_s * (t_s - static_cast<double>(thing.look.t_ref.ns()) * 1e-9);
      const Intersection m = std::visit(
          [&](const auto& shape) {
            return intersect(shape, o - moved, d, static_cast<double>(query.near_m),
                             static_cast<double>(ray.far_m));
          },
          thing.shape);
      if (m.range_m < best.range_m) best = m, met = &thing, shift = moved;
    }
    if (!met) return hit;
    if (best.normal.dot(d) > 0) best.normal = -best.normal;
    hit.range_m = static_cast<float>(best.range_m);
    for (int i = 0; i < 3; ++i) hit.normal[i] = static_cast<float>(best.normal[i]);
    const auto band = static_cast<std::size_t>(query.band);
    hit.reflectance = met->look.reflectance[band];
    hit.transmittance = met->look.transmittance;
    hit.roughness = met->look.roughness;
    hit.metallic = met->look.metallic;
    hit.retro_reflection = met->look.retro_reflection;
    hit.water = met->look.water;
    hit.node = met->look.node;
    hit.surface = met->surface.get();
    if (met->look.map) met->look.map(hit, o + d * best.range_m - shift, query.band);
    hit.cos_incidence = std::max(
        0.0F, static_cast<float>(-(Eigen::Vector3d(hit.normal[0], hit.normal[1], hit.normal[2]).dot(d))));
    return hit;
  }

  std::vector<Thing> things_;
  std::shared_ptr<const render::ContentWindow> window_;
};

/// The content that goes with it: light and air; shapes are the engine's. Keeps what it was asked for.
class AnalyticWorld final : public render::ContentSource {
 public:
  AnalyticWorld() {
    auto sky = std::make_shared<render::SkyMap>();
    sky->width = sky->height = 1;
    sky->radiance.assign(1, render::Spectrum{});
    frame.light.sky = sky;
    frame.light.direction_to_sun = {0, 0, -1};
  }
  [[nodiscard]] std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query,
                                                                     BenchTime begin, BenchTime end,
                                                                     int instants) override {
    asked = query;
    asked_instants = instants;
    auto window = std::make_shared<render::ContentWindow>();
    window->begin = begin;
    window->end = end;
    window->frames = {std::make_shared<const render::ContentFrame>(frame)};
    return window;
  }
  [[nodiscard]] Eigen::Isometry3d T_world_node(world::NodeId node, BenchTime t) const override {
    const auto found = poses.find(node);
    return found == poses.end() ? Eigen::Isometry3d::Identity() : found->second(t);
  }
  [[nodiscard]] std::string type_name(world::NodeId node) const override {
    const auto found = types.find(node);
    return found == types.end() ? "" : found->second;
  }

  render::ContentFrame frame;
  std::map<world::NodeId, std::string> types;
  std::map<world::NodeId, render::PoseFunction> poses;
  render::ContentQuery asked;  ///< the last query
  int asked_instants = 0;
};

/// A pose that does not change, looking along world x with z up.
[[nodiscard]] inline render::PoseFunction still(const Eigen::Vector3d& position = Eigen::Vector3d::Zero()) {
  return [position](BenchTime) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation() = position;
    return pose;
  };
}

}  // namespace rigor::test
