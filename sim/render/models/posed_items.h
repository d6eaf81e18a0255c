// Things that keep their shape and have a pose as a function of time.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sim/render/content/provider.h"
#include "sim/world/graph/changes.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::render {

struct PosedItem {
  std::shared_ptr<const Prototype> prototype{};  ///< null: cannot be shown
  Eigen::Quaterniond q_node_mesh = Eigen::Quaterniond::Identity();
  float scale = 1.0F;
  std::vector<std::string> warnings{};
  std::vector<NodeId> materials{};  ///< Material nodes that it was made with

  // Where it was last: what stands still keeps its batch.
  Eigen::Isometry3d T_world_last = Eigen::Isometry3d::Identity();
  std::shared_ptr<const Batch> last{};
};

/// By node, in order.
class PosedItems {
 public:
  void clear() { items_.clear(); }
  void put(NodeId node, PosedItem item) { items_[node] = std::move(item); }
  void erase(NodeId node) { items_.erase(node); }
  [[nodiscard]] std::vector<NodeId> made_with(NodeId material) const;
  [[nodiscard]] std::vector<std::string> warnings() const;
  /// Adds each at its pose at query.t. Nodes whose pose is not finite are left out.
  void collect(const world::Snapshot& world, const ContentQuery& query, ContentFrame& frame);

 private:
  std::map<NodeId, PosedItem> items_;
};

/// Whether a change of a node of a Frame type can change more than where it is.
[[nodiscard]] bool changes_shape(const world::Schema& schema, const world::Change& change);

}  // namespace rigor::render
