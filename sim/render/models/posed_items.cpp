#include "sim/render/models/posed_items.h"

#include <algorithm>

#include "sim/render/models/mesh_builder.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {
/// No turntable goes round in whole turns in this.
constexpr Duration kWhile = milliseconds(7);
}  // namespace

std::vector<NodeId> PosedItems::made_with(NodeId material) const {
  std::vector<NodeId> out;
  for (const auto& [node, item] : items_)
    if (std::find(item.materials.begin(), item.materials.end(), material) != item.materials.end())
      out.push_back(node);
  return out;
}

std::vector<std::string> PosedItems::warnings() const {
  std::vector<std::string> all;
  for (const auto& [node, item] : items_) all.insert(all.end(), item.warnings.begin(), item.warnings.end());
  return all;
}

void PosedItems::collect(const world::Snapshot& world, const ContentQuery& query, ContentFrame& frame) {
  for (auto& [node, item] : items_) {
    if (!item.prototype) continue;
    const Eigen::Isometry3d T_world_node = world.T_world_node(node, query.t);
    if (!T_world_node.matrix().allFinite()) continue;
    // Motions are even: what is elsewhere a while later is in motion now.
    const bool moves = world.T_world_node(node, query.t + kWhile).matrix() != T_world_node.matrix();
    if (!item.last || item.last->moves != moves || T_world_node.matrix() != item.T_world_last.matrix()) {
      auto batch = std::make_shared<Batch>();
      batch->moves = moves;
      batch->prototype = item.prototype;
      batch->origin = T_world_node.translation();
      batch->node = node;
      Instance instance = instance_at(T_world_node * item.q_node_mesh, batch->origin);
      for (float& s : instance.scale) s = item.scale;
      batch->instances.push_back(instance);
      batch->bounds = bounds_of(*batch);
      item.last = std::move(batch);
      item.T_world_last = T_world_node;
    }
    if (query.may_matter(item.last->bounds)) frame.batches.push_back(item.last);
  }
}

bool changes_shape(const world::Schema& schema, const world::Change& change) {
  if (change.kind == world::ChangeKind::connected || change.kind == world::ChangeKind::disconnected)
    return change.edge != schema.require_edge("part_of");
  if (change.kind != world::ChangeKind::changed) return true;
  if (change.attribute == world::AttributeId{}) return false;
  const world::types::Frame t(schema);
  for (const world::AttributeId a : {t.name.id, t.pose.id, t.motion.id, t.moves.id})
    if (change.attribute == a) return false;
  return true;
}

}  // namespace rigor::render
