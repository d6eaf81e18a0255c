#include "bench/live/world_shapes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "sim/nature/trees/allometry.h"
#include "sim/world/semantic_types.h"

namespace rigor::live {
namespace {

using world::Vector3;
constexpr double kNone = std::numeric_limits<double>::infinity();

double z_or_ground(double z_m, double x_m, double y_m, const GroundHeight& ground) {
  if (!std::isnan(z_m)) return z_m;
  const double under = ground(x_m, y_m);
  return std::isnan(under) ? 0 : under;
}

double lowest_ground(const std::vector<double>& ring, const GroundHeight& ground) {
  double z = kNone;
  for (std::size_t i = 0; i + 1 < ring.size(); i += 2)
    if (const double g = ground(ring[i], ring[i + 1]); !std::isnan(g)) z = std::min(z, g);
  return std::isinf(z) ? 0 : z;
}

bool inside_ring(const std::vector<double>& ring, double x, double y) {
  bool in = false;
  const std::size_t n = ring.size() / 2;
  for (std::size_t i = 0, j = n - 1; i < n; j = i++) {
    const double xi = ring[2 * i], yi = ring[2 * i + 1], xj = ring[2 * j], yj = ring[2 * j + 1];
    if ((yi > y) != (yj > y) && x < (xj - xi) * (y - yi) / (yj - yi) + xi) in = !in;
  }
  return in;
}

double distance_to_line(const std::vector<double>& line, double x, double y) {
  double best = kNone;
  for (std::size_t i = 0; i + 3 < line.size(); i += 2) {
    const double ax = line[i], ay = line[i + 1], bx = line[i + 2] - ax, by = line[i + 3] - ay;
    const double length2 = bx * bx + by * by;
    const double s = length2 > 0 ? std::clamp(((x - ax) * bx + (y - ay) * by) / length2, 0.0, 1.0) : 0;
    best = std::min(best, std::hypot(x - ax - s * bx, y - ay - s * by));
  }
  return best;
}

// ---- rays, in the solid's own frame: the least distance at or beyond 0; kNone: none

double hit_box(const Vector3& o, const Vector3& d, const Vector3& half) {
  double near = 0, far = kNone;
  for (int i = 0; i < 3; ++i) {
    if (d[i] == 0) {
      if (std::abs(o[i]) > half[i]) return kNone;
      continue;
    }
    const double a = (-half[i] - o[i]) / d[i], b = (half[i] - o[i]) / d[i];
    near = std::max(near, std::min(a, b));
    far = std::min(far, std::max(a, b));
  }
  return near <= far ? near : kNone;
}

double hit_cylinder(const Vector3& o, const Vector3& d, double radius, double z_from, double z_to) {
  double best = kNone;
  const double a = d.x() * d.x() + d.y() * d.y(), b = o.x() * d.x() + o.y() * d.y();
  const double c = o.x() * o.x() + o.y() * o.y() - radius * radius, under = b * b - a * c;
  if (a > 0 && under >= 0) {
    const double s = (-b - std::sqrt(under)) / a, z = o.z() + s * d.z();
    if (s >= 0 && z >= z_from && z <= z_to) best = s;
  }
  if (d.z() != 0)
    for (const double z : {z_from, z_to}) {
      const double s = (z - o.z()) / d.z();
      if (s >= 0 && s < best && std::hypot(o.x() + s * d.x(), o.y() + s * d.y()) <= radius) best = s;
    }
  return best;
}

double hit_ellipsoid(const Vector3& o, const Vector3& d, double radius, double half_height) {
  if (!(radius > 0) || !(half_height > 0)) return kNone;
  const Vector3 scale(radius, radius, half_height);
  const Vector3 p = o.cwiseQuotient(scale), v = d.cwiseQuotient(scale);
  const double a = v.squaredNorm(), b = p.dot(v), under = b * b - a * (p.squaredNorm() - 1);
  if (under < 0) return kNone;
  const double s = (-b - std::sqrt(under)) / a;
  return s >= 0 ? s : kNone;
}

double hit_prism(const Shape& s, const Vector3& o, const Vector3& d) {
  double best = kNone;
  const auto& ring = s.outline_m;
  const double z0 = s.T_world_node.translation().z(), z1 = z0 + s.height_m;
  const std::size_t n = ring.size() / 2;
  for (std::size_t i = 0, j = n - 1; i < n; j = i++) {
    const double ex = ring[2 * i] - ring[2 * j], ey = ring[2 * i + 1] - ring[2 * j + 1];
    const double px = ring[2 * j] - o.x(), py = ring[2 * j + 1] - o.y(), cross = d.x() * ey - d.y() * ex;
    if (cross == 0) continue;
    const double t = (px * ey - py * ex) / cross, along = (px * d.y() - py * d.x()) / cross;
    const double z = o.z() + t * d.z();
    if (t >= 0 && along >= 0 && along <= 1 && z >= z0 && z <= z1) best = std::min(best, t);
  }
  if (d.z() != 0)
    if (const double t = (z1 - o.z()) / d.z();
        t >= 0 && t < best && inside_ring(ring, o.x() + t * d.x(), o.y() + t * d.y()))
      best = t;
  return best;
}

double hit_plane(const Vector3& o, const Vector3& d, double half) {
  if (d.z() == 0) return kNone;
  const double s = -o.z() / d.z();
  return s >= 0 && std::abs(o.x() + s * d.x()) <= half && std::abs(o.y() + s * d.y()) <= half ? s : kNone;
}

double hit(const Shape& s, const Vector3& origin, const Vector3& direction) {
  const Vector3 at = s.T_world_node.translation();
  switch (s.kind) {
    case Shape::Kind::box:
    case Shape::Kind::cylinder:
    case Shape::Kind::plane: {
      const world::Pose T_node_world = s.T_world_node.inverse();
      const Vector3 o = T_node_world * origin, d = T_node_world.linear() * direction;
      if (s.kind == Shape::Kind::box) return hit_box(o, d, s.size_m / 2);
      if (s.kind == Shape::Kind::plane) return hit_plane(o, d, s.size_m.x() / 2);
      return hit_cylinder(o, d, s.size_m.x() / 2, -s.size_m.z() / 2, s.size_m.z() / 2);
    }
    case Shape::Kind::tree: {
      const double trunk = hit_cylinder(origin - at, direction, std::max(s.radius_m, 0.03), 0, s.height_m);
      const double half = (s.height_m - s.crown_base_m) / 2;
      const Vector3 middle = at + Vector3(0, 0, s.crown_base_m + half);
      return std::min(trunk, hit_ellipsoid(origin - middle, direction, s.crown_radius_m, half));
    }
    case Shape::Kind::outline:
      return hit_prism(s, origin, direction);
    case Shape::Kind::line:
    case Shape::Kind::point:
      return kNone;
  }
  return kNone;
}

/// Where a ray meets the terrain, to a centimetre; looked for in steps that grow with the distance.
double hit_terrain(const Vector3& o, const Vector3& d, const GroundHeight& ground, double at_most) {
  constexpr double kFar_m = 2000;
  const auto above = [&](double s) {
    return o.z() + s * d.z() - ground(o.x() + s * d.x(), o.y() + s * d.y());
  };
  double from = 0;
  for (double s = 0.1; s < std::min(at_most, kFar_m); s += 0.1 + 0.005 * s) {
    if (!(above(s) <= 0)) {  // NaN: no ground there
      from = s;
      continue;
    }
    double to = s;
    while (to - from > 0.01) {
      const double middle = (from + to) / 2;
      (above(middle) <= 0 ? to : from) = middle;
    }
    return to;
  }
  return kNone;
}

bool part_of_any(const world::Snapshot& w, world::NodeId node, world::EdgeTypeId part_of,
                 const std::set<world::NodeId>& roots) {
  for (world::NodeId n = node; n; n = w.target(n, part_of))
    if (roots.contains(n)) return true;
  return false;
}

double ring_area(const std::vector<double>& ring) {
  double area = 0;
  const std::size_t n = ring.size() / 2;
  for (std::size_t i = 0, j = n - 1; i < n; j = i++)
    area += ring[2 * j] * ring[2 * i + 1] - ring[2 * i] * ring[2 * j + 1];
  return std::abs(area) / 2;
}

/// Area of the ground plan, and whether it holds the point.
std::pair<double, bool> plan(const Shape& s, double x, double y) {
  const Vector3 at = s.T_world_node.translation();
  if (leans(s)) {
    const std::vector<double> ring = ground_plan(s);
    return {ring_area(ring), inside_ring(ring, x, y)};
  }
  switch (s.kind) {
    case Shape::Kind::box:
    case Shape::Kind::cylinder:
    case Shape::Kind::plane: {
      const Vector3 local = s.T_world_node.inverse() * Vector3(x, y, at.z());
      const bool round = s.kind == Shape::Kind::cylinder;
      const bool in =
          round ? std::hypot(local.x(), local.y()) <= s.size_m.x() / 2
                : std::abs(local.x()) <= s.size_m.x() / 2 && std::abs(local.y()) <= s.size_m.y() / 2;
      return {s.size_m.x() * s.size_m.y(), in};
    }
    case Shape::Kind::tree: {
      // Of trees whose crowns overlap the nearest trunk is meant.
      const double r = std::hypot(x - at.x(), y - at.y());
      return {r * r, r <= std::max({s.crown_radius_m, s.radius_m, 0.3})};
    }
    case Shape::Kind::outline:
      return {ring_area(s.outline_m), inside_ring(s.outline_m, x, y)};
    case Shape::Kind::line:
      return {1e6, distance_to_line(s.outline_m, x, y) <= std::max(s.width_m / 2, 0.2)};
    case Shape::Kind::point:
      return {0.05, std::hypot(x - at.x(), y - at.y()) <= 0.25};
  }
  return {kNone, false};
}

Shape solid(const world::Snapshot& w, const world::types::Body& body, world::NodeId n, BenchTime t) {
  Shape s{.node = n};
  s.kind = w.get_or_default(n, body.shape) == "cylinder" ? Shape::Kind::cylinder : Shape::Kind::box;
  s.T_world_node = w.T_world_node(n, t);
  s.size_m = w.get_or_default(n, body.size_m);
  return s;
}

class Collector {
 public:
  Collector(const world::Snapshot& world, BenchTime t, const GroundHeight& ground,
            const std::set<world::NodeId>& without)
      : w_(world), schema_(world.schema()), t_(t), ground_(ground), without_(without) {}

  std::vector<Shape> run() {
    bodies();
    trees();
    outlines();
    lines();
    return std::move(shapes_);
  }

 private:
  void add(Shape s) {
    if (s.T_world_node.translation().allFinite()) shapes_.push_back(std::move(s));
  }
  void bodies() {
    const world::types::Body body(schema_);
    const world::types::GroundPlane plane(schema_);
    w_.for_each(body.type, [&](world::NodeId n) {
      if (!without_.empty() && part_of_any(w_, n, body.part_of, without_)) return;
      add(solid(w_, body, n, t_));
    });
    w_.for_each(plane.type, [&](world::NodeId n) {
      Shape s{.node = n, .kind = Shape::Kind::plane};
      s.T_world_node = w_.T_world_node(n, t_);
      const double side = 2 * w_.get_or_default(n, plane.half_extent_m);
      s.size_m = Vector3(side, side, 0);
      add(std::move(s));
    });
    const world::types::Model model(schema_);
    for (const world::TypeId type : {model.type, world::types::Lamp(schema_).type})
      w_.for_each(type, [&](world::NodeId n) {
        Shape s{.node = n};
        s.T_world_node = w_.T_world_node(n, t_);
        add(std::move(s));
      });
  }
  void trees() {
    const world::types::Tree tree(schema_);
    w_.for_each(tree.type, [&](world::NodeId n) {
      const Vector3& p = w_.get_or_default(n, tree.position);
      if (!std::isfinite(p.x() + p.y())) return;
      const nature::TreeSize size = nature::size_of(
          *nature::find_species(w_.get_or_default(n, tree.species)).species,
          {w_.get_or_default(n, tree.dbh_m), w_.get_or_default(n, tree.height_m),
           w_.get_or_default(n, tree.crown_radius_m), w_.get_or_default(n, tree.crown_base_m)});
      Shape s{.node = n, .kind = Shape::Kind::tree};
      s.T_world_node.translation() = Vector3(p.x(), p.y(), z_or_ground(p.z(), p.x(), p.y(), ground_));
      s.radius_m = size.dbh_m / 2;
      s.height_m = size.height_m;
      s.crown_radius_m = size.crown_radius_m;
      s.crown_base_m = size.crown_base_m;
      add(std::move(s));
    });
    const world::types::Pole pole(schema_);
    w_.for_each(pole.type, [&](world::NodeId n) {
      const Vector3& p = w_.get_or_default(n, pole.position);
      const double d = w_.get_or_default(n, pole.diameter_m), h = w_.get_or_default(n, pole.height_m);
      Shape s{.node = n, .kind = Shape::Kind::cylinder};
      s.T_world_node.translation() = Vector3(p.x(), p.y(), z_or_ground(p.z(), p.x(), p.y(), ground_) + h / 2);
      s.size_m = Vector3(d, d, h);
      add(std::move(s));
    });
  }
  void ring(world::NodeId n, const world::Numbers& numbers, double z_m, double height_m) {
    if (numbers.size() < 6) return;
    Shape s{.node = n, .kind = Shape::Kind::outline};
    s.outline_m.assign(numbers.span().begin(),
                       numbers.span().end() - static_cast<std::ptrdiff_t>(numbers.size() % 2));
    const double z = std::isnan(z_m) ? lowest_ground(s.outline_m, ground_) : z_m;
    s.T_world_node.translation() = Vector3(s.outline_m[0], s.outline_m[1], z);
    s.height_m = height_m;
    add(std::move(s));
  }
  void outlines() {
    const world::types::Building building(schema_);
    w_.for_each(building.type, [&](world::NodeId n) {
      ring(n, w_.get_or_default(n, building.footprint), w_.get_or_default(n, building.base_m),
           w_.get_or_default(n, building.height_m) + w_.get_or_default(n, building.roof_height_m));
    });
    const world::types::Water water(schema_);
    w_.for_each(water.type, [&](world::NodeId n) {
      ring(n, w_.get_or_default(n, water.outline), w_.get_or_default(n, water.level_m), 0);
    });
  }
  void line(world::NodeId n, const world::Numbers& numbers, double width_m) {
    if (numbers.size() < 4) return;
    Shape s{.node = n, .kind = Shape::Kind::line};
    s.outline_m.assign(numbers.span().begin(), numbers.span().end());
    s.T_world_node.translation() = Vector3(numbers[0], numbers[1], 0);
    s.width_m = width_m;
    add(std::move(s));
  }
  void lines() {
    const world::types::Road road(schema_);
    w_.for_each(road.type, [&](world::NodeId n) {
      line(n, w_.get_or_default(n, road.line), w_.get_or_default(n, road.width_m));
    });
    const world::types::Fence fence(schema_);
    w_.for_each(fence.type, [&](world::NodeId n) { line(n, w_.get_or_default(n, fence.line), 0.1); });
  }

  const world::Snapshot& w_;
  const world::Schema& schema_;
  BenchTime t_;
  const GroundHeight& ground_;
  const std::set<world::NodeId>& without_;
  std::vector<Shape> shapes_;
};

}  // namespace

std::vector<Shape> parts_of(const world::Snapshot& world, BenchTime t, world::NodeId root) {
  const world::types::Body body(world.schema());
  std::vector<Shape> parts;
  world.for_each(body.type, [&](world::NodeId n) {
    if (part_of_any(world, n, body.part_of, {root})) parts.push_back(solid(world, body, n, t));
  });
  return parts;
}

bool leans(const Shape& s) {
  constexpr double kUpright = 0.9998;  // to a degree
  return (s.kind == Shape::Kind::box || s.kind == Shape::Kind::cylinder) &&
         std::abs(s.T_world_node.linear()(2, 2)) < kUpright;
}

std::vector<double> ground_plan(const Shape& s) {
  using Point = std::pair<double, double>;
  std::vector<Point> points;
  for (const double x : {-0.5, 0.5})
    for (const double y : {-0.5, 0.5})
      for (const double z : {-0.5, 0.5}) {
        const Vector3 p = s.T_world_node * s.size_m.cwiseProduct(Vector3(x, y, z));
        points.emplace_back(p.x(), p.y());
      }
  std::sort(points.begin(), points.end());
  // Andrew's chains: from the least to the greatest x, and back.
  std::vector<Point> hull;
  for (int side = 0; side < 2; ++side) {
    const std::size_t begin = hull.size();
    for (const Point& p : points) {
      const auto turns_left = [&] {
        const Point &a = hull[hull.size() - 2], &b = hull.back();
        return (b.first - a.first) * (p.second - a.second) - (b.second - a.second) * (p.first - a.first) > 0;
      };
      while (hull.size() >= begin + 2 && !turns_left()) hull.pop_back();
      hull.push_back(p);
    }
    hull.pop_back();  // the other chain begins with it
    std::reverse(points.begin(), points.end());
  }
  std::vector<double> ring;
  for (const Point& p : hull) ring.insert(ring.end(), {p.first, p.second});
  return ring;
}

std::vector<Shape> shapes_of(const world::Snapshot& world, BenchTime t, const GroundHeight& ground,
                             const std::set<world::NodeId>& without) {
  return Collector(world, t, ground, without).run();
}

std::optional<Hit> first_hit(const std::vector<Shape>& shapes, const Vector3& origin,
                             const Vector3& direction, const GroundHeight& ground, world::NodeId terrain) {
  Hit best;
  best.distance_m = kNone;
  for (const Shape& s : shapes)
    if (const double d = hit(s, origin, direction); d < best.distance_m) {
      best.node = s.node;
      best.distance_m = d;
    }
  if (terrain)
    if (const double d = hit_terrain(origin, direction, ground, best.distance_m); d < best.distance_m) {
      best.node = terrain;
      best.distance_m = d;
    }
  if (!best.node) return {};
  best.point_m = origin + best.distance_m * direction;
  return best;
}

std::optional<Hit> at_place(const std::vector<Shape>& shapes, double x_m, double y_m,
                            const GroundHeight& ground, world::NodeId terrain) {
  double least = kNone;
  Hit best;
  for (const Shape& s : shapes) {
    const auto [area, in] = plan(s, x_m, y_m);
    if (in && area < least) {
      least = area;
      best.node = s.node;
    }
  }
  const double z = ground(x_m, y_m);
  if (!best.node && terrain && !std::isnan(z)) best.node = terrain;
  if (!best.node) return {};
  best.point_m = Vector3(x_m, y_m, std::isnan(z) ? 0 : z);
  return best;
}

}  // namespace rigor::live
