#include "sim/nature/built/building_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/nature/built/facade.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using render::MeshBuilder;
using render::PictureFrame;

constexpr double kPlinth_m = 0.2, kSill_m = 0.95, kHead_m = 2.2, kDoorHead_m = 2.25;
constexpr double kWindow_m = 1.1, kBay_m = 2.6, kStorey_m = 2.8, kInset_m = 0.12;
constexpr double kOpeningAboveGround_m = 0.15;

// Pictures lie upright on a slope: down its fall line, and level across.
PictureFrame picture_on(const Vector3d& n, const Cover& c) {
  const double level = std::hypot(n.x(), n.y());
  const Vector3d right = level > 1e-6 ? Vector3d(-n.y() / level, n.x() / level, 0) : Vector3d::UnitX();
  const Vector3d down = right.cross(n);
  return {.origin = Vector3d::Zero(), .right = right * c.repeats_per_m, .down = down * c.repeats_per_m};
}

void add_facet(MeshBuilder& mesh, const Cover& c, const Vector3d& a, const Vector3d& b, const Vector3d& d) {
  const Vector3d n = (b - a).cross(d - a);
  if (n.norm() > 0) mesh.triangle(c.surface, a, b, d, picture_on(n.normalized(), c));
}

void add_shell(MeshBuilder& mesh, const Shell& shell, const Cover& covered, const Cover& gable,
               const Cover& edge) {
  for (const Facet& f : shell.facets) {
    const Cover& c = f.tag == kCovered ? covered : f.tag == kGable ? gable : edge;
    const auto p = [&](std::size_t k) { return shell.points[static_cast<std::size_t>(f.corner[k])]; };
    add_facet(mesh, c, p(0), p(1), p(2));
  }
}

struct Edge {
  Vector2d from, to;
  bool court = false;  // of a hole
  [[nodiscard]] double length() const { return (to - from).norm(); }
  [[nodiscard]] Vector2d at(double x) const { return from + (to - from) / length() * x; }
  [[nodiscard]] Vector2d out() const {
    const Vector2d d = (to - from) / length();
    return {d.y(), -d.x()};
  }
};

std::vector<Edge> edges_of(const Polygon& polygon) {
  std::vector<Edge> all;
  bool court = false;
  for (const auto& r : polygon.rings()) {
    for (std::size_t i = 0; i < r.size(); ++i) all.push_back({r[i], r[(i + 1) % r.size()], court});
    court = true;
  }
  return all;
}

struct Plan {
  double plinth_m = 0;
  std::vector<std::vector<Opening>> openings;  // of each edge
  struct Step {
    Edge edge;
    double x_m = 0;
  };
  std::vector<Step> steps;
};

class Planner {
 public:
  Planner(const BuildingSpec& spec, const std::vector<Edge>& edges) : spec_(spec), edges_(edges) {}

  Plan plan() {
    Plan p;
    p.plinth_m = std::min(kPlinth_m, 0.3 * spec_.height_m);
    p.openings.resize(edges_.size());
    if (!spec_.openings || spec_.height_m < kHead_m + 0.15) return p;
    const int storeys = std::max(1, static_cast<int>(std::floor(spec_.height_m / kStorey_m + 0.25)));
    const double storey = spec_.height_m / storeys;
    const std::size_t front = door_edge();
    for (std::size_t e = 0; e < edges_.size(); ++e) {
      const double length = edges_[e].length();
      int bays = length < kWindow_m + 1.0 ? 0 : std::max(1, static_cast<int>(std::floor(length / kBay_m)));
      if (e == front) bays = std::max(bays, 1);
      for (int b = 0; b < bays; ++b) {
        const double x = length * (b + 0.5) / bays;
        const double width = std::min(kWindow_m, length - 0.4);
        const bool door = e == front && b == bays / 2;
        for (int s = 0; s < storeys; ++s) {
          Opening o{.x0_m = x - width / 2, .x1_m = x + width / 2};
          o.door = door && s == 0;
          o.z0_m = o.door ? p.plinth_m + 0.03 : s * storey + kSill_m;
          o.z1_m = o.door ? std::min(kDoorHead_m, spec_.height_m - 0.1)
                          : s * storey + std::min(kHead_m, storey - 0.25);
          if (o.door) o.z1_m = s * storey + std::min(kHead_m, storey - 0.25);
          if (!o.door && buried(edges_[e], o)) continue;
          p.openings[e].push_back(o);
        }
        if (door) p.steps.push_back({edges_[e], x});
      }
    }
    return p;
  }

 private:
  [[nodiscard]] double ground(const Vector2d& p) const {
    const double z = spec_.ground ? spec_.ground(p) : std::numeric_limits<double>::quiet_NaN();
    return std::isnan(z) ? 0.0 : z;
  }
  [[nodiscard]] bool buried(const Edge& e, const Opening& o) const {
    return std::max(ground(e.at(o.x0_m)), ground(e.at(o.x1_m))) > o.z0_m - kOpeningAboveGround_m;
  }
  // The door goes where the ground is nearest to the floor; of several such walls, into the longest.
  [[nodiscard]] std::size_t door_edge() const {
    std::size_t best = edges_.size();
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < edges_.size(); ++i) {
      const Edge& e = edges_[i];
      if (e.court || e.length() < 1.3) continue;
      const double cost = 20 * std::abs(ground(e.at(e.length() / 2))) - std::min(e.length(), 15.0);
      if (cost < least - 1e-6) {
        least = cost;
        best = i;
      }
    }
    return best;
  }

  const BuildingSpec& spec_;
  const std::vector<Edge>& edges_;
};

enum class Detail : std::uint8_t { set_in, flush, bare };

void add_walls(MeshBuilder& mesh, const BuildingSpec& spec, const std::vector<Edge>& edges, const Plan& plan,
               bool covered_top, Detail detail) {
  const Cover& plinth = cover(Finish::concrete);
  for (std::size_t e = 0; e < edges.size(); ++e) {
    WallSpec wall{.from = edges[e].from,
                  .to = edges[e].to,
                  .z0_m = -spec.foundation_m,
                  .z1_m = plan.plinth_m,
                  .cover = plinth};
    add_wall(mesh, wall);
    wall.z0_m = plan.plinth_m;
    wall.z1_m = spec.height_m;
    wall.cover = spec.walls;
    if (detail != Detail::bare) wall.openings = plan.openings[e];
    wall.inset_m = detail == Detail::set_in ? kInset_m : 0.0;
    add_wall(mesh, wall);
  }
  const Cover& top = covered_top ? spec.roof_cover : spec.walls;
  for (const auto& t : triangulate(spec.footprint)) {
    const auto at = [](const Vector2d& p, double z) { return Vector3d(p.x(), p.y(), z); };
    add_facet(mesh, top, at(t[0], spec.height_m), at(t[1], spec.height_m), at(t[2], spec.height_m));
    add_facet(mesh, plinth, at(t[0], -spec.foundation_m), at(t[2], -spec.foundation_m),
              at(t[1], -spec.foundation_m));
  }
}

void add_step(MeshBuilder& mesh, const Plan::Step& step, const Plan& plan, double bottom_m) {
  const Vector2d along = (step.edge.to - step.edge.from).normalized(), out = step.edge.out();
  const Vector2d middle = step.edge.at(step.x_m);
  const Polygon slab{.outer = {middle - 0.75 * along + 0.9 * out, middle + 0.75 * along + 0.9 * out,
                               middle + 0.75 * along - 0.02 * out, middle - 0.75 * along - 0.02 * out},
                     .holes = {}};
  const Cover& c = cover(Finish::concrete);
  add_shell(mesh, prism(slab, bottom_m, plan.plinth_m + 0.02), c, c, c);
}

void add_chimney(MeshBuilder& mesh, const Vector3d& ridge, const Polygon& footprint) {
  constexpr double kHalf_m = 0.3, kAbove_m = 0.7, kBelow_m = 1.2;
  const Vector2d at = ridge.head<2>();
  const Polygon stack{.outer = {at + Vector2d(-kHalf_m, -kHalf_m), at + Vector2d(kHalf_m, -kHalf_m),
                                at + Vector2d(kHalf_m, kHalf_m), at + Vector2d(-kHalf_m, kHalf_m)},
                      .holes = {}};
  for (const Vector2d& p : stack.outer)
    if (!contains(footprint, p)) return;
  const Cover &c = cover(Finish::brick), &top = cover(Finish::concrete);
  add_shell(mesh, prism(stack, ridge.z() - kBelow_m, ridge.z() + kAbove_m), top, c, c);
}

// A highest point of the roof with room for a chimney: from an end of the ridge towards the middle.
Vector3d chimney_place(const Roof& roof, const Polygon& footprint) {
  Vector3d other = *roof.top;
  for (const Shell& s : roof.shells)
    for (const Vector3d& p : s.points)
      if (p.z() > roof.top->z() - 1e-4 && (p - *roof.top).norm() > (other - *roof.top).norm() + 1e-6)
        other = p;
  const Vector3d place = *roof.top + 0.3 * (other - *roof.top);
  return contains(footprint, place.head<2>()) ? place : *roof.top;
}

}  // namespace

BuildingMesh make_building(const BuildingSpec& spec) {
  BuildingMesh out;
  const Roof roof = make_roof(spec.footprint, {.shape = spec.roof,
                                               .eaves_m = spec.height_m,
                                               .height_m = spec.roof_height_m,
                                               .overhang_m = spec.overhang_m});
  out.warnings = roof.warnings;
  const auto edges = edges_of(spec.footprint);
  const Plan plan = Planner(spec, edges).plan();
  const double size_m2 = area(spec.footprint);
  const bool pitched = roof.top.has_value();
  const bool chimney =
      spec.chimney && pitched && roof.shape != RoofShape::pyramidal && size_m2 > 40 && size_m2 < 800;
  const Cover& trim = cover(Finish::window_frame);
  const Cover& fascia = pitched || roof.shape == RoofShape::shed ? trim : spec.walls;
  const std::pair<Detail, double> details[] = {
      {Detail::set_in, 0.0}, {Detail::flush, kInset_m}, {Detail::bare, kWindow_m}};
  const bool any_openings =
      std::any_of(plan.openings.begin(), plan.openings.end(), [](const auto& o) { return !o.empty(); });
  for (const auto& [detail, error_m] : details) {
    if (!any_openings && detail != Detail::set_in) break;
    MeshBuilder mesh;
    add_walls(mesh, spec, edges, plan, !pitched, detail);
    for (const Shell& s : roof.shells)
      add_shell(mesh, s, roof.shape == RoofShape::flat ? spec.walls : spec.roof_cover, spec.walls, fascia);
    if (detail != Detail::bare)
      for (const auto& step : plan.steps) add_step(mesh, step, plan, -spec.foundation_m);
    if (chimney) add_chimney(mesh, chimney_place(roof, spec.footprint), spec.footprint);
    out.levels.push_back({mesh.finish(), static_cast<float>(error_m)});
  }
  return out;
}

}  // namespace rigor::nature::built
