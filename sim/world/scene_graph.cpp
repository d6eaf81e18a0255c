#include "sim/world/scene_graph.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>

#include "sim/world/semantic_types.h"

namespace rigor::world {
namespace {

Numbers spectrum(const Bands& b) { return {b[0], b[1], b[2], b[3], b[3], b[3]}; }
Bands bands(const Numbers& s) {
  Bands b{};
  for (std::size_t i = 0; i < b.size() && i < s.size(); ++i) b[i] = s[i];
  return b;
}

/// Takes writes one after the other and keeps the first error.
class Writer {
 public:
  explicit Writer(Database& db, std::string label) : tx_(db.begin(std::move(label))) {}
  NodeId make(TypeId type) {
    if (!status_) return {};
    auto id = tx_.create(type);
    if (!id) status_ = tl::unexpected(id.error());
    return id ? *id : NodeId{};
  }
  template <class T>
  void set(NodeId node, Attribute<T> attribute, T value) {
    if (status_) status_ = tx_.set(node, attribute, std::move(value));
  }
  void connect(NodeId source, EdgeTypeId edge, NodeId target) {
    if (status_) status_ = tx_.connect(source, edge, target);
  }
  Status commit() {
    if (!status_) return status_;
    return tx_.commit();
  }

 private:
  Transaction tx_;
  Status status_{};
};

std::string named(const Snapshot& world, NodeId node, const types::Object& object) {
  const auto* name = world.get(node, object.name);
  return name && !name->empty() ? "'" + *name + "'" : "node " + std::to_string(node.value);
}

std::vector<NodeId> in_order(const Snapshot& world, TypeId type) {
  auto nodes = world.nodes(type);
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

/// Reads a snapshot into a Scene; throws nothing, remembers what did not fit.
struct Reader {
  const Snapshot& world;
  const types::Frame frame;
  const types::Hinge hinge;
  const types::Body body;
  const types::GroundPlane plane;
  const types::Material material;
  const types::StudioLight light;
  Scene scene{};
  std::map<NodeId, std::size_t> nodes{}, materials{};

  explicit Reader(const Snapshot& w)
      : world(w),
        frame(w.schema()),
        hinge(w.schema()),
        body(w.schema()),
        plane(w.schema()),
        material(w.schema()),
        light(w.schema()) {}

  Result<std::optional<std::size_t>> parent_of(NodeId node) const {
    const NodeId parent = world.target(node, frame.part_of);
    if (!parent) return std::optional<std::size_t>{};
    const auto at = nodes.find(parent);
    if (at == nodes.end())
      return fail(
          ErrorCode::bad_input, named(world, node, frame),
          "expected to be part of a frame that was made before it, got " + named(world, parent, frame));
    return std::optional<std::size_t>{at->second};
  }
  Result<std::size_t> material_of(NodeId node, EdgeTypeId edge) const {
    const auto at = materials.find(world.target(node, edge));
    if (at == materials.end())
      return fail(ErrorCode::bad_input, named(world, node, frame),
                  "expected a material (edge " + world.schema().edge(edge).name + "), found none");
    return at->second;
  }

  void read_materials() {
    for (const NodeId id : in_order(world, material.type)) {
      materials[id] = scene.materials.size();
      scene.materials.push_back({.name = *world.get(id, material.name),
                                 .reflectance = bands(*world.get(id, material.reflectance)),
                                 .roughness = *world.get(id, material.roughness)});
    }
  }
  Status read_frames() {
    for (const NodeId id : in_order(world, frame.type)) {
      const bool turns = world.is_a(id, hinge.type);
      if (!turns && world.type_of(id) != frame.type) continue;  // bodies and others that have frames
      auto parent = parent_of(id);
      if (!parent) return tl::unexpected(parent.error());
      Node node{
          .name = *world.get(id, frame.name), .parent = *parent, .T_parent_node = *world.get(id, frame.pose)};
      if (turns) node.hinge = Hinge{*world.get(id, hinge.axis)};
      nodes[id] = scene.nodes.size();
      scene.nodes.push_back(std::move(node));
    }
    return {};
  }
  Status read_bodies() {
    for (const NodeId id : in_order(world, body.type)) {
      auto node = parent_of(id);
      if (!node) return tl::unexpected(node.error());
      auto made_of = material_of(id, body.made_of);
      if (!made_of) return tl::unexpected(made_of.error());
      Body b{.name = *world.get(id, body.name),
             .node = *node,
             .T_node_body = *world.get(id, body.pose),
             .shape = *world.get(id, body.shape) == "cylinder" ? Shape::cylinder : Shape::box,
             .size_m = *world.get(id, body.size_m),
             .material = *made_of};
      if (const auto columns = *world.get(id, body.chessboard_columns); columns > 0) {
        auto dark = material_of(id, body.dark_squares_of);
        if (!dark) return tl::unexpected(dark.error());
        b.chessboard = Chessboard{.columns = static_cast<int>(columns),
                                  .rows = static_cast<int>(*world.get(id, body.chessboard_rows)),
                                  .square_m = *world.get(id, body.chessboard_square_m),
                                  .dark_material = *dark};
      }
      scene.bodies.push_back(std::move(b));
    }
    return {};
  }
  Status read_ground() {
    const auto planes = in_order(world, plane.type);
    if (planes.size() > 1)
      return fail(ErrorCode::bad_input, named(world, planes[1], plane),
                  "expected one GroundPlane, got a second one");
    for (const NodeId id : planes) {
      auto made_of = material_of(id, plane.made_of);
      if (!made_of) return tl::unexpected(made_of.error());
      const auto other =
          world.target(id, plane.other_cells_of) ? material_of(id, plane.other_cells_of) : made_of;
      if (!other) return tl::unexpected(other.error());
      scene.ground = Ground{.T_world_ground = world.T_world_node(id, BenchTime(0)),
                            .half_extent_m = *world.get(id, plane.half_extent_m),
                            .material = *made_of,
                            .other_material = *other,
                            .cell_m = *world.get(id, plane.cell_m),
                            .noise_contrast = *world.get(id, plane.noise_contrast)};
    }
    return {};
  }
  Status read_light() {
    const auto lights = in_order(world, light.type);
    if (lights.size() > 1)
      return fail(ErrorCode::bad_input, named(world, lights[1], light),
                  "expected one StudioLight, got a second one");
    for (const NodeId id : lights) {
      scene.sun = {.direction_to_sun = *world.get(id, light.direction_to_sun),
                   .irradiance_w_per_m2 = bands(*world.get(id, light.sun_irradiance_w_per_m2))};
      scene.sky = {.zenith_radiance_w_per_m2_sr = bands(*world.get(id, light.zenith_radiance_w_per_m2_sr)),
                   .horizon_radiance_w_per_m2_sr = bands(*world.get(id, light.horizon_radiance_w_per_m2_sr))};
    }
    return {};
  }
};

}  // namespace

Status put_scene(Database& db, const Scene& scene) {
  const Schema& s = db.schema();
  const types::Frame frame(s);
  const types::Hinge hinge(s);
  const types::Body body(s);
  const types::GroundPlane plane(s);
  const types::Material material(s);
  const types::StudioLight light(s);
  Writer w(db, "scene");
  std::vector<NodeId> materials, nodes;
  for (const auto& m : scene.materials) {
    materials.push_back(w.make(material.type));
    w.set(materials.back(), material.name, m.name);
    w.set(materials.back(), material.reflectance, spectrum(m.reflectance));
    w.set(materials.back(), material.roughness, m.roughness);
  }
  for (const auto& n : scene.nodes) {
    const NodeId id = w.make(n.hinge ? hinge.type : frame.type);
    nodes.push_back(id);
    w.set(id, frame.name, n.name);
    w.set(id, frame.pose, n.T_parent_node);
    if (n.hinge) w.set(id, hinge.axis, n.hinge->axis);
    if (n.parent) w.connect(id, frame.part_of, nodes[*n.parent]);
  }
  for (const auto& b : scene.bodies) {
    const NodeId id = w.make(body.type);
    w.set(id, body.name, b.name);
    w.set(id, body.pose, b.T_node_body);
    w.set(id, body.shape, std::string(b.shape == Shape::cylinder ? "cylinder" : "box"));
    w.set(id, body.size_m, b.size_m);
    w.connect(id, body.made_of, materials[b.material]);
    if (b.node) w.connect(id, body.part_of, nodes[*b.node]);
    if (!b.chessboard) continue;
    w.set(id, body.chessboard_columns, std::int64_t{b.chessboard->columns});
    w.set(id, body.chessboard_rows, std::int64_t{b.chessboard->rows});
    w.set(id, body.chessboard_square_m, b.chessboard->square_m);
    w.connect(id, body.dark_squares_of, materials[b.chessboard->dark_material]);
  }
  if (scene.ground) {
    const auto& g = *scene.ground;
    const NodeId id = w.make(plane.type);
    w.set(id, plane.pose, g.T_world_ground);
    w.set(id, plane.half_extent_m, g.half_extent_m);
    w.set(id, plane.cell_m, g.cell_m);
    w.set(id, plane.noise_contrast, g.noise_contrast);
    w.connect(id, plane.made_of, materials[g.material]);
    w.connect(id, plane.other_cells_of, materials[g.other_material]);
  }
  const NodeId id = w.make(light.type);
  w.set(id, light.direction_to_sun, scene.sun.direction_to_sun);
  w.set(id, light.sun_irradiance_w_per_m2, spectrum(scene.sun.irradiance_w_per_m2));
  w.set(id, light.zenith_radiance_w_per_m2_sr, spectrum(scene.sky.zenith_radiance_w_per_m2_sr));
  w.set(id, light.horizon_radiance_w_per_m2_sr, spectrum(scene.sky.horizon_radiance_w_per_m2_sr));
  return w.commit();
}

Result<Scene> scene_of(const Snapshot& world) {
  Reader r(world);
  r.read_materials();
  for (auto step : {&Reader::read_frames, &Reader::read_bodies, &Reader::read_ground, &Reader::read_light})
    if (auto s = (r.*step)(); !s) return tl::unexpected(s.error());
  if (auto s = r.scene.validate(); !s) return tl::unexpected(s.error());
  return std::move(r.scene);
}

}  // namespace rigor::world
