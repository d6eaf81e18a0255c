#include "sim/world/world_yaml.h"

#include <Eigen/Geometry>
#include <numbers>
#include <string>
#include <vector>

#include "sensor-hal/config/yaml.h"

namespace rigor::world {
namespace {

double radians(double deg) { return deg * std::numbers::pi / 180.0; }

Eigen::Vector3d vector3(const ConfigNode& n, std::string_view key, const std::vector<double>& fallback) {
  const std::vector<double> v = n.numbers_or(key, fallback);
  return {v[0], v[1], v[2]};
}

Eigen::Vector3d direction(const ConfigNode& n, std::string_view key, const std::vector<double>& fallback) {
  const Eigen::Vector3d v = vector3(n, key, fallback);
  if (!(v.norm() > 1e-9)) throw n.error(key, "expected a direction, got a vector of length 0");
  return v.normalized();
}

/// `position_m: [x, y, z]` and `roll_pitch_yaw_deg: [r, p, y]`: R = Rz(yaw) Ry(pitch) Rx(roll).
Eigen::Isometry3d pose(const ConfigNode& n) {
  const Eigen::Vector3d p = vector3(n, "position_m", {0, 0, 0});
  const Eigen::Vector3d a = vector3(n, "roll_pitch_yaw_deg", {0, 0, 0});
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translate(p);
  T.rotate(Eigen::AngleAxisd(radians(a.z()), Eigen::Vector3d::UnitZ()) *
           Eigen::AngleAxisd(radians(a.y()), Eigen::Vector3d::UnitY()) *
           Eigen::AngleAxisd(radians(a.x()), Eigen::Vector3d::UnitX()));
  return T;
}

Bands bands(const ConfigNode& n, Range range) {
  Bands b{n.number("red", range), n.number("green", range), n.number("blue", range), n.number("nir", range)};
  n.finish();
  return b;
}

template <class List>
std::size_t index_of(const ConfigNode& n, std::string_view key, const std::string& name, const List& list,
                     const char* what) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < list.size(); ++i) {
    if (list[i].name == name) return i;
    names.push_back(list[i].name);
  }
  const std::string near = nearest(name, names);
  throw n.error(key, std::string("expected the name of a ") + what + " listed before, got '" + name + "'" +
                         (near.empty() ? "" : "; did you mean '" + near + "'?"));
}

template <class List>
std::string new_name(const ConfigNode& n, const List& list) {
  std::string name = n.text("name");
  for (const auto& other : list)
    if (other.name == name)
      throw n.error("name", "expected a name of its own, got '" + name + "' a second time");
  return name;
}

std::optional<std::size_t> node_of(const ConfigNode& n, std::string_view key, const Scene& scene) {
  if (!n.has(key)) return std::nullopt;
  return index_of(n, key, n.text(key), scene.nodes, "node");
}

Node read_node(const ConfigNode& n, const Scene& scene) {
  Node node;
  node.name = new_name(n, scene.nodes);
  node.parent = node_of(n, "parent", scene);
  node.T_parent_node = pose(n);
  if (n.has("hinge")) {
    const ConfigNode h = n.map("hinge");
    node.hinge = Hinge{direction(h, "axis", {0, 0, 1})};
    h.finish();
  }
  n.finish();
  return node;
}

Body read_body(const ConfigNode& n, const Scene& scene) {
  constexpr Range kLength{.min = 0, .max = 1e6, .exclusive_min = true};
  Body body;
  body.name = new_name(n, scene.bodies);
  body.node = node_of(n, "node", scene);
  body.T_node_body = pose(n);
  body.material = index_of(n, "material", n.text("material"), scene.materials, "material");
  if (n.choice_or("shape", {"box", "cylinder"}, "box") == "cylinder") {
    body.shape = Shape::cylinder;
    const double diameter_m = n.number("diameter_m", kLength);
    body.size_m = {diameter_m, diameter_m, n.number("height_m", kLength)};
  } else {
    const std::vector<double> size = n.numbers("size_m", 3);
    body.size_m = {size[0], size[1], size[2]};
    if (!(body.size_m.minCoeff() > 0.0 && body.size_m.maxCoeff() <= kLength.max))
      throw n.error("size_m", "expected three lengths above 0 and up to 1e6 m");
  }
  if (n.has("chessboard")) {
    const ConfigNode c = n.map("chessboard");
    Chessboard board;
    board.columns = static_cast<int>(c.integer_or("columns", 9, {.min = 2, .max = 1000}));
    board.rows = static_cast<int>(c.integer_or("rows", 6, {.min = 2, .max = 1000}));
    board.square_m = c.number_or("square_m", 0.1, kLength);
    board.dark_material = index_of(c, "dark_material", c.text("dark_material"), scene.materials, "material");
    c.finish();
    if (body.shape != Shape::box) throw n.error("chessboard", "expected a box to carry it, got a cylinder");
    const double width_m = board.square_m * (board.columns + 1), height_m = board.square_m * (board.rows + 1);
    if (width_m > body.size_m.x() + 1e-9 || height_m > body.size_m.y() + 1e-9)
      throw n.error("chessboard", "expected a board that fits on the face x, y of size_m, got one of " +
                                      std::to_string(width_m) + " x " + std::to_string(height_m) + " m");
    body.chessboard = board;
  }
  n.finish();
  return body;
}

Scene read_scene(const ConfigNode& root) {
  constexpr Range kRadiance{.min = 0, .max = 1e6};
  Scene scene;
  for (const ConfigNode& n : root.list("materials")) {
    Material m;
    m.name = new_name(n, scene.materials);
    m.reflectance = bands(n.map("reflectance"), {.min = 0, .max = 1});
    m.roughness = n.number_or("roughness", 1.0, {.min = 0.05, .max = 1});
    n.finish();
    scene.materials.push_back(m);
  }
  for (const ConfigNode& n : root.list_or_empty("nodes")) scene.nodes.push_back(read_node(n, scene));
  for (const ConfigNode& n : root.list_or_empty("bodies")) scene.bodies.push_back(read_body(n, scene));
  if (root.has("ground")) {
    const ConfigNode n = root.map("ground");
    Ground g;
    g.T_world_ground = pose(n);
    g.half_extent_m = n.number_or("half_extent_m", 100.0, {.min = 0, .max = 1e5, .exclusive_min = true});
    g.material = index_of(n, "material", n.text("material"), scene.materials, "material");
    g.other_material = n.has("other_material") ? index_of(n, "other_material", n.text("other_material"),
                                                          scene.materials, "material")
                                               : g.material;
    g.cell_m = n.number_or("cell_m", 1.0, {.min = 1e-3, .max = 1e6});
    g.noise_contrast = n.number_or("noise_contrast", 0.0, {.min = 0, .max = 1});
    n.finish();
    scene.ground = g;
  }
  if (root.has("sun")) {
    const ConfigNode n = root.map("sun");
    scene.sun.direction_to_sun = direction(n, "direction_to_sun", {0.4, -0.3, 0.866});
    scene.sun.irradiance_w_per_m2 = bands(n.map("irradiance_w_per_m2"), kRadiance);
    n.finish();
  }
  if (root.has("sky")) {
    const ConfigNode n = root.map("sky");
    scene.sky.zenith_radiance_w_per_m2_sr = bands(n.map("zenith_radiance_w_per_m2_sr"), kRadiance);
    scene.sky.horizon_radiance_w_per_m2_sr = bands(n.map("horizon_radiance_w_per_m2_sr"), kRadiance);
    n.finish();
  }
  // Read by whoever opens the world: plugins are loaded before it is read (docs/world-plugins.md).
  for (const char* key : {"plugins", "plugin_files"}) (void)root.list_or_empty(key);
  root.finish();
  return scene;
}

Result<Scene> read(Result<ConfigNode> root, const std::string& name) {
  if (!root) return tl::unexpected(root.error());
  auto scene = catch_config([&] { return read_scene(*root); });
  if (!scene) return scene;
  // Everything that validate() refuses was refused above with its place; this is the net below.
  if (auto s = scene->validate(); !s) return fail(s.error().code, name, s.error().text());
  return scene;
}

}  // namespace

Result<Scene> load_world(const std::filesystem::path& file) {
  return read(ConfigDocument::load(file), file.string());
}
Result<Scene> parse_world(std::string_view text, std::string_view name) {
  return read(ConfigDocument::parse(text, name), std::string(name));
}

}  // namespace rigor::world
