#include "sim/world/scene.h"

#include <cmath>

namespace rigor::world {
namespace {

Status bad(const std::string& where, const std::string& message) {
  return fail(ErrorCode::bad_input, "world: " + where, message);
}

bool all_in(const Bands& bands, double low, double high) {
  for (const double v : bands)
    if (!(v >= low && v <= high)) return false;
  return true;
}

template <class List>
std::optional<std::size_t> find_by_name(const List& list, std::string_view name) {
  for (std::size_t i = 0; i < list.size(); ++i)
    if (list[i].name == name) return i;
  return std::nullopt;
}

}  // namespace

Status Scene::validate() const {
  const auto is_unit = [](const Eigen::Vector3d& v) { return std::abs(v.norm() - 1.0) < 1e-6; };
  for (const Material& m : materials) {
    if (!all_in(m.reflectance, 0.0, 1.0))
      return bad("material '" + m.name + "'", "reflectance: expected values in [0, 1]");
    if (!(m.roughness >= 0.05 && m.roughness <= 1.0))
      return bad("material '" + m.name + "'", "roughness: expected a value in [0.05, 1]");
  }
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (nodes[i].parent && *nodes[i].parent >= i)
      return bad("node '" + nodes[i].name + "'", "parent: expected a node that stands before it");
    if (nodes[i].hinge && !is_unit(nodes[i].hinge->axis))
      return bad("node '" + nodes[i].name + "'", "hinge axis: expected a vector of length 1");
    if (!nodes[i].T_parent_node.matrix().allFinite())
      return bad("node '" + nodes[i].name + "'", "pose: expected finite numbers");
  }
  for (const Body& b : bodies) {
    const std::string where = "body '" + b.name + "'";
    if (b.node && *b.node >= nodes.size()) return bad(where, "node: no such node");
    if (b.material >= materials.size()) return bad(where, "material: no such material");
    if (!(b.size_m.minCoeff() > 0.0) || !b.size_m.allFinite())
      return bad(where, "size: expected three positive lengths");
    if (b.shape == Shape::cylinder && b.size_m.x() != b.size_m.y())
      return bad(where, "size: expected a cylinder's first two lengths (its diameter) to be equal");
    if (!b.T_node_body.matrix().allFinite()) return bad(where, "pose: expected finite numbers");
    if (b.chessboard) {
      const Chessboard& c = *b.chessboard;
      if (b.shape != Shape::box) return bad(where, "chessboard: expected a box to carry it");
      if (c.columns < 2 || c.rows < 2 || c.columns > 1000 || c.rows > 1000)
        return bad(where, "chessboard: expected 2 to 1000 inner corners in each direction");
      if (!(c.square_m > 0.0)) return bad(where, "chessboard: expected a positive square size");
      if (c.dark_material >= materials.size()) return bad(where, "chessboard: no such material");
      if (c.square_m * (c.columns + 1) > b.size_m.x() + 1e-9 ||
          c.square_m * (c.rows + 1) > b.size_m.y() + 1e-9)
        return bad(where, "chessboard: expected a board that fits on the body's +z face");
    }
  }
  if (ground) {
    if (ground->material >= materials.size() || ground->other_material >= materials.size())
      return bad("ground", "material: no such material");
    if (!(ground->half_extent_m > 0.0) || !(ground->half_extent_m <= 1e5))
      return bad("ground", "half_extent_m: expected a length in (0, 100000]");
    if (!(ground->cell_m >= 1e-3)) return bad("ground", "cell_m: expected at least 0.001");
    if (!(ground->noise_contrast >= 0.0 && ground->noise_contrast <= 1.0))
      return bad("ground", "noise_contrast: expected a value in [0, 1]");
  }
  if (!is_unit(sun.direction_to_sun)) return bad("sun", "direction: expected a vector of length 1");
  if (!all_in(sun.irradiance_w_per_m2, 0.0, 1e6))
    return bad("sun", "irradiance: expected values in [0, 1e6]");
  if (!all_in(sky.zenith_radiance_w_per_m2_sr, 0.0, 1e6) ||
      !all_in(sky.horizon_radiance_w_per_m2_sr, 0.0, 1e6))
    return bad("sky", "radiance: expected values in [0, 1e6]");
  return {};
}

std::optional<std::size_t> find_node(const Scene& scene, std::string_view name) {
  return find_by_name(scene.nodes, name);
}
std::optional<std::size_t> find_body(const Scene& scene, std::string_view name) {
  return find_by_name(scene.bodies, name);
}

Eigen::Isometry3d T_world_node(const Scene& scene, const WorldSnapshot& snapshot,
                               std::optional<std::size_t> node, BenchTime t) {
  Eigen::Isometry3d T_world_result = Eigen::Isometry3d::Identity();
  while (node) {
    const Node& n = scene.nodes[*node];
    Eigen::Isometry3d T_parent_node = n.T_parent_node;
    if (n.hinge) T_parent_node.rotate(Eigen::AngleAxisd(snapshot.joints[*node].angle_at(t), n.hinge->axis));
    T_world_result = T_parent_node * T_world_result;
    node = n.parent;
  }
  return T_world_result;
}

Eigen::Isometry3d T_world_body(const Scene& scene, const WorldSnapshot& snapshot, std::size_t body,
                               BenchTime t) {
  return T_world_node(scene, snapshot, scene.bodies[body].node, t) * scene.bodies[body].T_node_body;
}

std::vector<Eigen::Vector3d> chessboard_corners_in_body(const Body& body) {
  std::vector<Eigen::Vector3d> corners;
  if (!body.chessboard) return corners;
  const Chessboard& c = *body.chessboard;
  for (int j = 0; j < c.rows; ++j)
    for (int i = 0; i < c.columns; ++i)
      corners.emplace_back((i - (c.columns - 1) / 2.0) * c.square_m, ((c.rows - 1) / 2.0 - j) * c.square_m,
                           body.size_m.z() / 2.0);
  return corners;
}

}  // namespace rigor::world
