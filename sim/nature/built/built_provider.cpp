#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>
#include <set>
#include <utility>

#include "sensor-hal/models/philox.h"
#include "sim/nature/built/building_mesh.h"
#include "sim/nature/built/fence.h"
#include "sim/nature/built/road_mesh.h"
#include "sim/nature/built/terrain_change.h"
#include "sim/nature/providers.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::nature {
namespace {

using namespace built;
using Eigen::Vector2d;
using Eigen::Vector3d;
using render::Batch;
using render::ContentFrame;
using render::ContentQuery;
using world::NodeId;
using world::Snapshot;

constexpr double kFoundation_m = 0.6;
constexpr double kProbe_m = 2.0;  // between probes of the ground under a footprint
constexpr int kMostProbes = 64;   // along each axis

// What the ground was where something asked for it: whether it must be made anew is seen by asking again.
struct Probe {
  double x, y, z;
};

struct Item {
  std::vector<std::shared_ptr<const Batch>> batches;
  std::vector<std::string> warnings;
  std::vector<Probe> probes;
  Eigen::AlignedBox2d reach;  // of the probes
  std::vector<NodeId> materials;
};

struct Types {
  explicit Types(const world::Schema& s) : building(s), road(s), fence(s), pole(s), material(s), terrain(s) {}
  world::types::Building building;
  world::types::Road road;
  world::types::Fence fence;
  world::types::Pole pole;
  world::types::Material material;
  world::types::Terrain terrain;
};

double uniform(NodeId node, std::uint32_t stream) {
  const auto key = models::channel_key(node.value, models::channel_id_from_name("built"));
  return models::philox({stream, 0, 0, 0}, key)[0] * 0x1p-32;
}

class BuiltProvider final : public render::ContentProvider {
 public:
  BuiltProvider(std::shared_ptr<const render::GroundHeights> ground, std::filesystem::path base_dir)
      : ground_(std::move(ground)), base_dir_(std::move(base_dir)) {}

  [[nodiscard]] std::string_view name() const override { return "built"; }

  void rebuild(const Snapshot& world) override {
    items_.clear();
    surfaces_.clear();
    const Types t(world.schema());
    for (const world::TypeId type : {t.building.type, t.road.type, t.fence.type, t.pole.type})
      for (const NodeId node : world.nodes(type)) make(world, t, node);
  }

  void apply(const world::ChangeSet& changes) override {
    const Types t(changes.after.schema());
    const auto& schema = changes.after.schema();
    std::set<NodeId> dirty;
    Eigen::AlignedBox2d ground;
    for (const world::Change& c : changes.changes) {
      if (schema.is_a(c.type, t.terrain.type)) {
        ground.extend(changed_ground(changes.before, changes.after, c.node));
      } else if (schema.is_a(c.type, t.material.type)) {
        surfaces_.erase(c.node);
        for (const auto& [node, item] : items_)
          if (std::find(item.materials.begin(), item.materials.end(), c.node) != item.materials.end())
            dirty.insert(node);
      } else if (is_mine(schema, t, c.type) && matters(t, c)) {
        dirty.insert(c.node);
      }
    }
    if (!ground.isEmpty())
      for (const auto& [node, item] : items_)
        if (!dirty.contains(node) && ground.intersects(item.reach) && ground_differs(item))
          dirty.insert(node);
    for (const NodeId node : dirty) {
      items_.erase(node);
      const auto type = changes.after.type_of(node);
      if (type && is_mine(schema, t, *type)) make(changes.after, t, node);
    }
  }

  void collect(const ContentQuery& query, ContentFrame& frame) override {
    for (const auto& [node, item] : items_)
      for (const auto& b : item.batches)
        if (query.may_matter(b->bounds)) frame.batches.push_back(b);
  }

  [[nodiscard]] std::vector<std::string> warnings() const override {
    std::vector<std::string> all;
    for (const auto& [node, item] : items_) all.insert(all.end(), item.warnings.begin(), item.warnings.end());
    return all;
  }

 private:
  static bool is_mine(const world::Schema& s, const Types& t, world::TypeId type) {
    return s.is_a(type, t.building.type) || s.is_a(type, t.road.type) || s.is_a(type, t.fence.type) ||
           s.is_a(type, t.pole.type);
  }
  static bool matters(const Types& t, const world::Change& c) {
    switch (c.kind) {
      case world::ChangeKind::changed:
        return c.attribute != world::AttributeId{} && c.attribute != t.building.name.id;
      case world::ChangeKind::connected:
      case world::ChangeKind::disconnected:
        return c.edge == t.building.made_of || c.edge == t.building.roof_of;
      default:
        return true;
    }
  }
  [[nodiscard]] bool ground_differs(const Item& item) const {
    return std::any_of(item.probes.begin(), item.probes.end(), [&](const Probe& p) {
      const double z = ground_->height_at(p.x, p.y);
      return z != p.z && !(std::isnan(z) && std::isnan(p.z));
    });
  }

  // The ground relative to an origin; what is asked is kept with the item.
  [[nodiscard]] std::function<double(const Vector2d&)> ground_for(Item& item, const Vector3d& origin) const {
    return [this, &item, origin](const Vector2d& p) {
      if (!ground_) return std::numeric_limits<double>::quiet_NaN();
      const double x = p.x() + origin.x(), y = p.y() + origin.y(), z = ground_->height_at(x, y);
      item.probes.push_back({x, y, z});
      return z - origin.z();
    };
  }

  void make(const Snapshot& world, const Types& t, NodeId node) {
    Item item;
    const auto type = world.type_of(node);
    if (!type) return;
    const auto& schema = world.schema();
    std::vector<std::string> said;
    std::string_view kind = "Building";
    if (schema.is_a(*type, t.building.type)) {
      said = make_building_of(world, t, node, item);
    } else if (schema.is_a(*type, t.road.type)) {
      kind = "Road";
      said = make_road_of(world, t, node, item);
    } else if (schema.is_a(*type, t.fence.type)) {
      kind = "Fence";
      said = make_fence_of(world, t, node, item);
    } else {
      kind = "Pole";
      said = make_pole_of(world, t, node, item);
    }
    const std::string& called = world.get_or_default(node, t.building.name);
    for (const std::string& s : said)
      item.warnings.push_back(called.empty() ? fmt::format("{} {}: {}", kind, node.value, s)
                                             : fmt::format("{} {} ({}): {}", kind, node.value, called, s));
    std::sort(item.probes.begin(), item.probes.end(),
              [](const Probe& a, const Probe& b) { return std::tie(a.x, a.y) < std::tie(b.x, b.y); });
    const auto same = [](const Probe& a, const Probe& b) { return a.x == b.x && a.y == b.y; };
    item.probes.erase(std::unique(item.probes.begin(), item.probes.end(), same), item.probes.end());
    for (const Probe& p : item.probes) item.reach.extend(Vector2d(p.x, p.y));
    items_[node] = std::move(item);
  }

  // The surface at the end of an edge; empty where there is none or its maps cannot be had.
  std::shared_ptr<const render::Surface> surface_at(const Snapshot& world, NodeId node,
                                                    world::EdgeTypeId edge, Item& item,
                                                    std::vector<std::string>& said) {
    const NodeId material = world.target(node, edge);
    if (!material) return nullptr;
    item.materials.push_back(material);
    auto found = surfaces_.find(material);
    if (found == surfaces_.end()) {
      auto surface = render::surface_of(world, material, base_dir_);
      if (!surface) {
        said.push_back(surface.error().text() + "; shown with its default cover");
        return nullptr;
      }
      found = surfaces_.emplace(material, with_pattern(*surface)).first;
    }
    return found->second;
  }

  std::vector<std::string> make_building_of(const Snapshot& world, const Types& t, NodeId node, Item& item) {
    std::vector<std::string> said;
    const auto footprint = world.get_or_default(node, t.building.footprint).span();
    const Vector2d middle = origin_near(footprint);
    auto polygon = polygon_from(footprint, world.get_or_default(node, t.building.holes).span(), middle, said);
    if (!polygon) {
      said.push_back(polygon.error().message + "; not shown");
      return said;
    }
    BuildingSpec spec;
    spec.footprint = std::move(*polygon);
    const double lowest = lowest_ground(spec.footprint, ground_for(item, {middle.x(), middle.y(), 0}));
    double base = world.get_or_default(node, t.building.base_m);
    if (!std::isfinite(base)) base = std::isfinite(lowest) ? lowest : 0.0;
    const Vector3d origin(middle.x(), middle.y(), base);
    spec.foundation_m = kFoundation_m + (std::isfinite(lowest) ? std::max(0.0, base - lowest) : 0.0);
    spec.ground = ground_for(item, origin);
    spec.height_m = world.get_or_default(node, t.building.height_m);
    spec.roof_height_m = world.get_or_default(node, t.building.roof_height_m);
    spec.roof = roof_shape(world.get_or_default(node, t.building.roof_shape));
    const bool pitched = spec.roof != RoofShape::flat && spec.roof_height_m > 0.01;
    spec.walls = default_walls(node);
    spec.roof_cover = default_roof(node, pitched);
    if (auto s = surface_at(world, node, t.building.made_of, item, said)) spec.walls = {s, repeats_of(*s)};
    if (auto s = surface_at(world, node, t.building.roof_of, item, said))
      spec.roof_cover = {s, repeats_of(*s)};
    BuildingMesh mesh = make_building(spec);
    said.insert(said.end(), mesh.warnings.begin(), mesh.warnings.end());
    item.batches.push_back(render::single_batch("building", node, origin, std::move(mesh.levels), true));
    return said;
  }

  std::vector<std::string> make_road_of(const Snapshot& world, const Types& t, NodeId node, Item& item) {
    const auto xy = world.get_or_default(node, t.road.line).span();
    const Vector2d middle = origin_near(xy);
    auto line = line_from(xy, middle);
    if (!line) return {line.error().message + "; not shown"};
    const Vector3d origin(middle.x(), middle.y(), 0);
    RoadSpec spec{.line = std::move(*line), .width_m = world.get_or_default(node, t.road.width_m)};
    const std::string& word = world.get_or_default(node, t.road.surface);
    spec.surface = word == "concrete" ? RoadSurface::concrete
                   : word == "gravel" ? RoadSurface::gravel
                   : word == "soil"   ? RoadSurface::soil
                                      : RoadSurface::asphalt;
    spec.ground = ground_for(item, origin);
    std::vector<std::string> said;
    spec.own_cover = surface_at(world, node, t.road.made_of, item, said);
    for (RoadPiece& p : make_road(spec))
      item.batches.push_back(
          render::single_batch("road", node, origin + p.origin, {{std::move(p.mesh), 0.0F}}, false));
    return said;
  }

  std::vector<std::string> make_fence_of(const Snapshot& world, const Types& t, NodeId node, Item& item) {
    const auto xy = world.get_or_default(node, t.fence.line).span();
    const Vector2d middle = origin_near(xy);
    auto line = line_from(xy, middle);
    if (!line) return {line.error().message + "; not shown"};
    std::vector<std::string> said;
    FenceSpec spec{.line = std::move(*line), .origin = Vector3d(middle.x(), middle.y(), 0)};
    spec.height_m = world.get_or_default(node, t.fence.height_m);
    spec.post_spacing_m = world.get_or_default(node, t.fence.post_spacing_m);
    const std::string& word = world.get_or_default(node, t.fence.style);
    spec.style = word == "rails"    ? FenceStyle::rails
                 : word == "boards" ? FenceStyle::boards
                                    : FenceStyle::wire;
    const double z =
        ground_ ? ground_->height_at(middle.x() + spec.line.front().x(), middle.y() + spec.line.front().y())
                : 0.0;
    if (std::isfinite(z)) spec.origin.z() = std::round(z);
    spec.ground = ground_for(item, spec.origin);
    spec.node = node;
    spec.surface = surface_at(world, node, t.fence.made_of, item, said);
    item.batches = make_fence(spec);
    return said;
  }

  std::vector<std::string> make_pole_of(const Snapshot& world, const Types& t, NodeId node, Item& item) {
    std::vector<std::string> said;
    PoleSpec spec{.foot = world.get_or_default(node, t.pole.position)};
    if (!spec.foot.head<2>().allFinite()) return {"its position is not finite; not shown"};
    if (!std::isfinite(spec.foot.z())) {
      const double z = ground_for(item, Vector3d::Zero())(spec.foot.head<2>());
      spec.foot.z() = std::isfinite(z) ? z : 0.0;
    }
    spec.height_m = world.get_or_default(node, t.pole.height_m);
    spec.diameter_m = world.get_or_default(node, t.pole.diameter_m);
    spec.node = node;
    spec.surface = surface_at(world, node, t.pole.made_of, item, said);
    item.batches.push_back(make_pole(spec));
    return said;
  }

  // Along the walls and on a grid inside; NaN where nothing is known.
  static double lowest_ground(const Polygon& polygon, const std::function<double(const Vector2d&)>& ground) {
    double lowest = std::numeric_limits<double>::quiet_NaN();
    const auto ask = [&](const Vector2d& p) {
      const double z = ground(p);
      if (std::isfinite(z) && !(z >= lowest)) lowest = z;
    };
    Eigen::AlignedBox2d box;
    for (const auto& r : polygon.rings())
      for (std::size_t i = 0; i < r.size(); ++i) {
        const Vector2d d = r[(i + 1) % r.size()] - r[i];
        const int n = std::clamp(static_cast<int>(std::ceil(d.norm() / kProbe_m)), 1, kMostProbes);
        for (int k = 0; k < n; ++k) ask(r[i] + d * k / n);
        box.extend(r[i]);
      }
    const int nx = std::clamp(static_cast<int>(box.sizes().x() / kProbe_m), 1, kMostProbes);
    const int ny = std::clamp(static_cast<int>(box.sizes().y() / kProbe_m), 1, kMostProbes);
    for (int i = 1; i < nx; ++i)
      for (int j = 1; j < ny; ++j) {
        const Vector2d p = box.min() + box.sizes().cwiseProduct(Vector2d(double(i) / nx, double(j) / ny));
        if (contains(polygon, p)) ask(p);
      }
    return lowest;
  }

  static RoofShape roof_shape(std::string_view word) {
    if (word == "gabled") return RoofShape::gabled;
    if (word == "hipped") return RoofShape::hipped;
    if (word == "pyramidal") return RoofShape::pyramidal;
    if (word == "shed") return RoofShape::shed;
    return RoofShape::flat;
  }
  static Cover default_walls(NodeId node) {
    const double u = uniform(node, 0);
    return cover(u < 0.4    ? Finish::plaster
                 : u < 0.6  ? Finish::plaster_ochre
                 : u < 0.75 ? Finish::plaster_grey
                            : Finish::brick);
  }
  static Cover default_roof(NodeId node, bool pitched) {
    if (!pitched) return cover(Finish::roof_felt);
    return cover(uniform(node, 1) < 0.75 ? Finish::roof_tiles : Finish::roof_slate);
  }

  std::shared_ptr<const render::GroundHeights> ground_;
  std::filesystem::path base_dir_;
  std::map<NodeId, Item> items_;
  std::map<NodeId, std::shared_ptr<const render::Surface>> surfaces_;
};

}  // namespace

std::unique_ptr<render::ContentProvider> make_built_provider(
    std::shared_ptr<const render::GroundHeights> ground, std::filesystem::path base_dir) {
  return std::make_unique<BuiltProvider>(std::move(ground), std::move(base_dir));
}

}  // namespace rigor::nature
