#include <algorithm>
#include <cmath>
#include <compare>
#include <map>
#include <numbers>
#include <optional>
#include <set>
#include <unordered_map>

#include "sim/nature/providers.h"
#include "sim/nature/trees/allometry.h"
#include "sim/nature/trees/draws.h"
#include "sim/nature/trees/stem_shape.h"
#include "sim/nature/trees/tree_mesh.h"
#include "sim/world/semantic_types.h"

namespace rigor::nature {
namespace {

using render::Batch;
using render::Instance;
using world::NodeId;

/// Wide enough that the trees of one kind in a tile make a worthwhile draw, narrow enough to be culled.
constexpr double kTile_m = 64;

struct TileKey {
  std::int32_t x = 0, y = 0;
  auto operator<=>(const TileKey&) const = default;
};
TileKey tile_at(double x, double y) {
  const auto cell = [](double v) {
    return static_cast<std::int32_t>(std::clamp(std::floor(v / kTile_m), -2e9, 2e9));
  };
  return {cell(x), cell(y)};
}

/// One prototype of the two kinds, as a key with an order of its own.
struct PartKey {
  std::optional<CrownKey> crown;
  std::optional<TrunkKey> trunk;
  auto operator<=>(const PartKey&) const = default;
};
const render::Prototype& prototype_of(const PartKey& k) {
  return k.crown ? *crown_prototype(*k.crown).prototype : *trunk_prototype(*k.trunk).prototype;
}
std::shared_ptr<const render::Prototype> shared_prototype_of(const PartKey& k) {
  return k.crown ? crown_prototype(*k.crown).prototype : trunk_prototype(*k.trunk).prototype;
}

/// Trees of one tile that share a prototype.
struct Group {
  struct Member {
    NodeId node;
    Eigen::Vector3d position;
    Instance instance;  ///< position: not yet relative to the batch
  };
  std::vector<Member> members;  ///< by node id
  std::shared_ptr<const Batch> batch;
};
struct Tile {
  std::map<PartKey, Group> groups;
  Eigen::AlignedBox3d bounds;
  void measure() {
    bounds.setEmpty();
    for (const auto& [key, group] : groups)
      if (group.batch) bounds.extend(group.batch->bounds);
  }
};

/// Where a tree stands in the structure, and what it was warned of.
struct Planted {
  TileKey tile;
  PartKey parts[2];
  int part_count = 0;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  bool on_terrain = false, off_terrain = false, no_size = false, bad_place = false;
  std::string unknown_species;
};

std::shared_ptr<const Batch> make_batch(const PartKey& key, const Group& group) {
  auto batch = std::make_shared<Batch>();
  batch->prototype = shared_prototype_of(key);
  batch->origin = group.members.front().position.array().round();
  Eigen::AlignedBox3f shape;
  for (const render::LevelOfDetail& level : prototype_of(key).levels) shape.extend(level.mesh->bounds);
  for (const Group::Member& m : group.members) {
    Instance i = m.instance;
    const Eigen::Vector3d foot = m.position + Eigen::Vector3d(0, 0, i.position[2]);
    for (int k = 0; k < 3; ++k) i.position[k] = static_cast<float>(foot[k] - batch->origin[k]);
    batch->instances.push_back(i);
    batch->nodes.push_back(m.node);
    // Turned about z by any angle.
    const double reach = std::max(std::max(std::abs(shape.min().x()), std::abs(shape.max().x())),
                                  std::max(std::abs(shape.min().y()), std::abs(shape.max().y()))) *
                         std::numbers::sqrt2 * static_cast<double>(i.scale[0]);
    // Room for the rounding of instances to float.
    const double margin = 1e-3 + 1e-6 * foot.cwiseAbs().maxCoeff();
    const Eigen::Vector3d low(-reach - margin, -reach - margin,
                              static_cast<double>(shape.min().z() * i.scale[2]) - margin);
    const Eigen::Vector3d high(reach + margin, reach + margin,
                               static_cast<double>(shape.max().z() * i.scale[2]) + margin);
    batch->bounds.extend(Eigen::Vector3d(foot + low));
    batch->bounds.extend(Eigen::Vector3d(foot + high));
  }
  return batch;
}

CrownKey crown_of(const ShownTree& tree, NodeId node) {
  const Draws draws("tree", node.value);
  return {tree.species->form, tree.species->bark, tree.age_class,
          static_cast<int>(draws.uniform(6, 0) * static_cast<float>(kCrownVariants))};
}

class TreeProvider final : public render::ContentProvider {
 public:
  explicit TreeProvider(std::shared_ptr<const render::GroundHeights> ground) : ground_(std::move(ground)) {}

  std::string_view name() const override { return "trees"; }
  std::uint64_t version() const override { return version_; }
  void rebuild(const world::Snapshot& world) override;
  void apply(const world::ChangeSet& changes) override;
  void collect(const render::ContentQuery& query, render::ContentFrame& frame) override;
  std::vector<std::string> warnings() const override;

 private:
  using Touched = std::set<std::pair<TileKey, PartKey>>;
  bool resolve(const world::Schema& schema);
  void plant(const world::Snapshot& world, NodeId node, Touched* touched);
  void fell(NodeId node, Touched* touched);
  void remake(const Touched& touched);
  [[nodiscard]] bool ground_moved(const Planted& p) const;

  std::shared_ptr<const render::GroundHeights> ground_;
  std::optional<world::types::Tree> types_;
  std::optional<world::TypeId> terrain_;
  std::map<TileKey, Tile> tiles_;
  std::unordered_map<NodeId, Planted> planted_;  // looked up alone; what is walked through is sorted
  std::uint64_t version_ = render::next_serial();
};

bool TreeProvider::resolve(const world::Schema& schema) {
  if (!types_ && schema.find_type("Tree")) types_.emplace(schema);
  if (!terrain_) terrain_ = schema.find_type("Terrain");
  return types_.has_value();
}

void TreeProvider::plant(const world::Snapshot& world, NodeId node, Touched* touched) {
  const Eigen::Vector3d* at = world.get(node, types_->position);
  if (!at) return;
  Planted p;
  p.position = *at;
  if (!std::isfinite(p.position.x()) || !std::isfinite(p.position.y()) || std::isinf(p.position.z())) {
    p.bad_place = true;
    planted_[node] = std::move(p);
    return;
  }
  p.on_terrain = std::isnan(p.position.z());
  if (p.on_terrain) {
    const double z = ground_ ? ground_->height_at(p.position.x(), p.position.y()) : NAN;
    p.off_terrain = !std::isfinite(z);
    p.position.z() = p.off_terrain ? 0 : z;
  }
  const ShownTree t = shown_tree(world, *types_, node);
  const Species& species = *t.species;
  const std::string& code = world.get_or_default(node, types_->species);
  if (!t.known) p.unknown_species = code.empty() ? std::string(" ") : code;
  p.no_size = t.size.seedling;
  const TreeSize& size = t.size;

  p.tile = tile_at(p.position.x(), p.position.y());
  Tile& tile = tiles_[p.tile];
  const auto put = [&](const PartKey& key, const Instance& instance) {
    Group& group = tile.groups[key];
    const Group::Member member{node, p.position, instance};
    if (group.members.empty() || group.members.back().node < node)
      group.members.push_back(member);
    else
      group.members.insert(std::lower_bound(group.members.begin(), group.members.end(), node,
                                            [](const Group::Member& m, NodeId n) { return m.node < n; }),
                           member);
    p.parts[p.part_count++] = key;
    if (touched) touched->insert({p.tile, key});
  };
  put({std::nullopt, t.trunk}, t.stem);
  if (!t.dead) {
    const Draws draws("tree", node.value);
    const CrownKey crown_key = crown_of(t, node);
    const CrownPrototype& crown = crown_prototype(crown_key);
    Instance leaves = t.upright;
    leaves.position[2] = static_cast<float>(size.crown_base_m);
    leaves.scale[0] = leaves.scale[1] = static_cast<float>(size.crown_radius_m) / crown.radius_m;
    leaves.scale[2] = static_cast<float>(size.height_m - size.crown_base_m) / crown.length_m;
    const float hue = 0.05F * draws.spread(7, 0);
    for (int k = 0; k < 3; ++k)
      leaves.tint[k] = species.foliage_tint[k] * t.light * (k == 1 ? 1.0F : 1 + hue);
    put({crown_key, std::nullopt}, leaves);
  }
  planted_[node] = std::move(p);
}

void TreeProvider::fell(NodeId node, Touched* touched) {
  const auto found = planted_.find(node);
  if (found == planted_.end()) return;
  const Planted& p = found->second;
  for (int k = 0; k < p.part_count; ++k) {
    auto& members = tiles_[p.tile].groups[p.parts[k]].members;
    const auto at = std::lower_bound(members.begin(), members.end(), node,
                                     [](const Group::Member& m, NodeId n) { return m.node < n; });
    if (at != members.end() && at->node == node) members.erase(at);
    if (touched) touched->insert({p.tile, p.parts[k]});
  }
  planted_.erase(found);
}

void TreeProvider::remake(const Touched& touched) {
  std::set<TileKey> tiles;
  for (const auto& [tile_key, part_key] : touched) {
    tiles.insert(tile_key);
    auto& groups = tiles_[tile_key].groups;
    const auto group = groups.find(part_key);
    if (group == groups.end()) continue;
    if (group->second.members.empty())
      groups.erase(group);
    else
      group->second.batch = make_batch(part_key, group->second);
  }
  for (const TileKey& key : tiles) {
    const auto tile = tiles_.find(key);
    if (tile->second.groups.empty())
      tiles_.erase(tile);
    else
      tile->second.measure();
  }
}

void TreeProvider::rebuild(const world::Snapshot& world) {
  version_ = render::next_serial();
  tiles_.clear();
  planted_.clear();
  types_.reset();
  terrain_.reset();
  if (!resolve(world.schema())) return;
  std::vector<NodeId> nodes = world.nodes(types_->type);
  std::sort(nodes.begin(), nodes.end());
  planted_.reserve(nodes.size());
  std::set<CrownKey> crowns;
  for (const NodeId node : nodes)
    if (const ShownTree t = shown_tree(world, *types_, node); !t.dead) crowns.insert(crown_of(t, node));
  make_crowns(crowns);
  for (const NodeId node : nodes) plant(world, node, nullptr);
  for (auto& [key, tile] : tiles_) {
    for (auto& [part, group] : tile.groups) group.batch = make_batch(part, group);
    tile.measure();
  }
}

bool TreeProvider::ground_moved(const Planted& p) const {
  if (!p.on_terrain || p.bad_place) return false;
  const double z = ground_ ? ground_->height_at(p.position.x(), p.position.y()) : NAN;
  return std::isfinite(z) ? p.off_terrain || z != p.position.z() : !p.off_terrain;
}

void TreeProvider::apply(const world::ChangeSet& changes) {
  if (!resolve(changes.after.schema())) return;
  const world::Schema& schema = changes.after.schema();
  std::set<NodeId> again;
  bool terrain = false;
  for (const world::Change& c : changes.changes) {
    if (c.kind == world::ChangeKind::connected || c.kind == world::ChangeKind::disconnected) continue;
    if (schema.is_a(c.type, types_->type)) {
      if (c.kind != world::ChangeKind::changed || c.attribute != types_->name.id) again.insert(c.node);
    } else if (terrain_ && schema.is_a(c.type, *terrain_)) {
      terrain = true;
    }
  }
  if (terrain)
    for (const auto& [node, p] : planted_)
      if (ground_moved(p)) again.insert(node);
  if (again.empty()) return;
  version_ = render::next_serial();
  Touched touched;
  for (const NodeId node : again) {
    fell(node, &touched);
    if (changes.after.contains(node)) plant(changes.after, node, &touched);
  }
  remake(touched);
}

void TreeProvider::collect(const render::ContentQuery& query, render::ContentFrame& frame) {
  for (const auto& [key, tile] : tiles_) {
    if (!query.may_matter(tile.bounds)) continue;
    for (const auto& [part, group] : tile.groups)
      if (group.batch && query.may_matter(group.batch->bounds)) frame.batches.push_back(group.batch);
  }
}

std::vector<std::string> TreeProvider::warnings() const {
  struct Count {
    std::size_t trees = 0;
    NodeId first{};
    void add(NodeId n) {
      if (trees++ == 0 || n < first) first = n;
    }
    [[nodiscard]] std::string text() const {
      return std::to_string(trees) + (trees == 1 ? " tree" : " trees") + " (first: node " +
             std::to_string(first.value) + ")";
    }
  };
  std::map<std::string, Count> unknown;
  Count no_size, off_terrain, bad_place;
  for (const auto& [node, p] : planted_) {
    if (!p.unknown_species.empty()) unknown[p.unknown_species].add(node);
    if (p.no_size) no_size.add(node);
    if (p.off_terrain) off_terrain.add(node);
    if (p.bad_place) bad_place.add(node);
  }
  std::vector<std::string> out;
  for (const auto& [code, count] : unknown)
    out.push_back(code == " " ? count.text() + " without species; shown as " +
                                    std::string(find_species("").species->name)
                              : "species \"" + code + "\" is not known, " + count.text() + "; shown as " +
                                    std::string(find_species(code).species->name) +
                                    "; expected a code such as TSHE or a genus such as Picea");
  if (no_size.trees) out.push_back(no_size.text() + " with neither dbh_m nor height_m; shown as seedlings");
  if (off_terrain.trees)
    out.push_back(off_terrain.text() + " outside the terrain, with z unknown; they stand at z 0");
  if (bad_place.trees) out.push_back(bad_place.text() + " whose position is not finite; not shown");
  return out;
}

}  // namespace

std::unique_ptr<render::ContentProvider> make_tree_provider(
    std::shared_ptr<const render::GroundHeights> ground) {
  return std::make_unique<TreeProvider>(std::move(ground));
}

}  // namespace rigor::nature
