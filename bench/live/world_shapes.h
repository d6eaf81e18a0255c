// What stands where in the world, as simple solids: for the map from above and for picking by a ray.
#pragma once

#include <functional>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "sim/world/graph/snapshot.h"

namespace rigor::live {

/// A node as it stands at an instant, in the world's frame.
struct Shape {
  enum class Kind : std::uint8_t {
    box,       ///< size_m along its own axes, about its origin
    cylinder,  ///< about its own z: diameter, diameter, height
    tree,      ///< a trunk from its foot upwards, a crown as an ellipsoid
    outline,   ///< a closed ring in x and y, from its foot upwards
    line,      ///< a way on the ground
    plane,     ///< a square of its own x and y
    point      ///< a node with a place and no size
  };
  world::NodeId node;
  Kind kind = Kind::point;
  world::Pose T_world_node = world::Pose::Identity();
  world::Vector3 size_m = world::Vector3::Zero();  ///< box, cylinder; plane: side, side, 0
  double radius_m = 0, height_m = 0;               ///< tree: trunk, whole; outline: height
  double crown_radius_m = 0, crown_base_m = 0;
  double width_m = 0;               ///< line
  std::vector<double> outline_m{};  ///< x0 y0 …
};

/// z of the ground; NaN where there is none.
using GroundHeight = std::function<double(double x_m, double y_m)>;

/// Every node that has a place and something to show there, but `without` and what is part of these. Trees
/// without a place are left out. Any thread.
[[nodiscard]] std::vector<Shape> shapes_of(const world::Snapshot& world, BenchTime t,
                                           const GroundHeight& ground,
                                           const std::set<world::NodeId>& without);

/// The boxes and cylinders that are part of `root`, itself among them. Any thread.
[[nodiscard]] std::vector<Shape> parts_of(const world::Snapshot& world, BenchTime t, world::NodeId root);

/// Whether it is a box or a cylinder whose own z is not upright, as that of a trunk on the ground.
[[nodiscard]] bool leans(const Shape& shape);
/// What a box or a cylinder covers of the ground, x0 y0 …: a convex ring round its corners.
[[nodiscard]] std::vector<double> ground_plan(const Shape& shape);

struct Hit {
  world::NodeId node{};
  double distance_m = 0;
  world::Vector3 point_m = world::Vector3::Zero();
};
/// The first that the ray meets, terrain among them (`terrain`: its node; none: there is no terrain).
/// `direction` has unit length.
[[nodiscard]] std::optional<Hit> first_hit(const std::vector<Shape>& shapes, const world::Vector3& origin,
                                           const world::Vector3& direction, const GroundHeight& ground,
                                           world::NodeId terrain);
/// The smallest whose ground plan holds the point; a tree's reaches to the edge of its crown.
[[nodiscard]] std::optional<Hit> at_place(const std::vector<Shape>& shapes, double x_m, double y_m,
                                          const GroundHeight& ground, world::NodeId terrain);

}  // namespace rigor::live
