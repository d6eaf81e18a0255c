#include <fmt/format.h>

#include <algorithm>
#include <set>
#include <utility>

#include "sim/render/content/surface_library.h"
#include "sim/render/models/body_mesh.h"
#include "sim/render/models/posed_items.h"
#include "sim/render/models/providers.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {

using world::Snapshot;

struct Types {
  explicit Types(const world::Schema& s) : body(s), ground(s), lamp(s), material(s) {}
  world::types::Body body;
  world::types::GroundPlane ground;
  world::types::Lamp lamp;
  world::types::Material material;
};

class BodyProvider final : public ContentProvider {
 public:
  explicit BodyProvider(std::filesystem::path base_dir) : base_dir_(std::move(base_dir)) {}

  [[nodiscard]] std::string_view name() const override { return "bodies"; }

  void rebuild(const Snapshot& world) override {
    items_.clear();
    surfaces_.clear();
    world_ = world;
    const Types t(world.schema());
    for (const world::TypeId type : {t.body.type, t.ground.type})
      for (const NodeId node : world.nodes(type)) make(t, node);
  }

  void apply(const world::ChangeSet& changes) override {
    world_ = changes.after;
    const auto& schema = world_.schema();
    const Types t(schema);
    std::set<NodeId> dirty;
    for (const world::Change& c : changes.changes) {
      if (schema.is_a(c.type, t.material.type)) {
        surfaces_.erase(c.node);
        for (const NodeId n : items_.made_with(c.node)) dirty.insert(n);
      } else if ((schema.is_a(c.type, t.body.type) || schema.is_a(c.type, t.ground.type)) &&
                 changes_shape(schema, c)) {
        dirty.insert(c.node);
      }
    }
    for (const NodeId node : dirty) {
      items_.erase(node);
      if (world_.contains(node)) make(t, node);
    }
  }

  void collect(const ContentQuery& query, ContentFrame& frame) override {
    items_.collect(world_, query, frame);
    const auto type = world_.schema().find_type("Lamp");
    if (!type || world_.count(*type) == 0) return;
    const world::types::Lamp t(world_.schema());
    std::vector<NodeId> lamps = world_.nodes(t.type);
    std::sort(lamps.begin(), lamps.end());
    for (const NodeId node : lamps) {
      PointLight light;
      light.position = world_.T_world_node(node, query.t).translation();
      const world::Numbers& w = world_.get_or_default(node, t.radiant_intensity_w_per_sr);
      bool shines = false;
      for (std::size_t b = 0; b < light.radiant_intensity.size() && b < w.size(); ++b) {
        light.radiant_intensity[b] = static_cast<float>(w[b]);
        shines = shines || w[b] > 0;
      }
      if (shines && light.position.allFinite()) frame.lamps.push_back(light);
    }
  }

  [[nodiscard]] std::vector<std::string> warnings() const override { return items_.warnings(); }

 private:
  // Grey where there is no material, or where its maps cannot be had.
  SurfacePtr surface_at(NodeId node, world::EdgeTypeId edge, PosedItem& item) {
    const NodeId material = world_.target(node, edge);
    if (!material) return SurfaceLibrary::builtin().get("");
    item.materials.push_back(material);
    auto found = surfaces_.find(material);
    if (found == surfaces_.end()) {
      auto surface = surface_of(world_, material, base_dir_);
      if (!surface) {
        item.warnings.push_back(
            fmt::format("node {}: {}; shown in grey", node.value, surface.error().text()));
        return SurfaceLibrary::builtin().get("");
      }
      found = surfaces_.emplace(material, *surface).first;
    }
    return found->second;
  }

  void make(const Types& t, NodeId node) {
    const auto type = world_.type_of(node);
    if (!type) return;
    PosedItem item;
    auto prototype = std::make_shared<Prototype>();
    const SurfacePtr own = surface_at(node, t.body.made_of, item);
    if (world_.schema().is_a(*type, t.body.type)) {
      prototype->name = "body";
      prototype->occludes = true;
      prototype->levels.push_back({body_mesh(t, node, own, item), 0.0F});
    } else {
      GroundPlaneSpec spec{.half_extent_m = world_.get_or_default(node, t.ground.half_extent_m),
                           .cell_m = world_.get_or_default(node, t.ground.cell_m),
                           .noise_contrast = world_.get_or_default(node, t.ground.noise_contrast),
                           .even = own,
                           .odd = own};
      if (world_.target(node, t.ground.other_cells_of))
        spec.odd = surface_at(node, t.ground.other_cells_of, item);
      if ((own->colour_map || spec.odd->colour_map) && (own != spec.odd || spec.noise_contrast > 0))
        item.warnings.push_back(fmt::format(
            "GroundPlane {}: pictures of its materials give way to its cells and noise", node.value));
      prototype->name = "ground_plane";
      prototype->levels.push_back({ground_mesh(spec), 0.0F});
    }
    item.prototype = std::move(prototype);
    items_.put(node, std::move(item));
  }

  std::shared_ptr<const Mesh> body_mesh(const Types& t, NodeId node, const SurfacePtr& own, PosedItem& item) {
    const world::Vector3 size = world_.get_or_default(node, t.body.size_m);
    const auto columns = world_.get_or_default(node, t.body.chessboard_columns);
    const auto rows = world_.get_or_default(node, t.body.chessboard_rows);
    const bool board = columns > 0 && rows > 0;
    if (world_.get_or_default(node, t.body.shape) == "cylinder") {
      if (board)
        item.warnings.push_back(
            fmt::format("Body {}: a chessboard needs a box; the cylinder has none", node.value));
      return cylinder_mesh(size, own);
    }
    if (!board) return box_mesh(size, own);
    const SurfacePtr dark = surface_at(node, t.body.dark_squares_of, item);
    return chessboard_mesh(size, own,
                           {.columns = static_cast<int>(columns),
                            .rows = static_cast<int>(rows),
                            .square_m = world_.get_or_default(node, t.body.chessboard_square_m),
                            .dark = dark});
  }

  std::filesystem::path base_dir_;
  Snapshot world_;
  PosedItems items_;
  std::map<NodeId, SurfacePtr> surfaces_;
};

}  // namespace

std::unique_ptr<ContentProvider> make_body_provider(std::filesystem::path base_dir) {
  return std::make_unique<BodyProvider>(std::move(base_dir));
}

}  // namespace rigor::render
