// What has changed since a file was last written, told by the database's signals.
#pragma once

#include <map>
#include <set>
#include <span>

#include "sim/world/graph/changes.h"

namespace rigor::world::store {

class DirtyNodes {
 public:
  struct Node {
    bool whole = false;  ///< was created or removed: all of it
    bool dynamic = false;
    std::set<AttributeId> attributes;
    std::set<EdgeTypeId> edges;  ///< by which it is the source
  };

  /// Transient attributes do not count.
  void note(const ChangeSet& set, std::span<const Change> changes);
  void note_all(const Snapshot& world);
  /// Nodes, attributes and edges that differ.
  void note_difference(const Snapshot& before, const Snapshot& after);
  [[nodiscard]] const std::map<NodeId, Node>& nodes() const noexcept { return nodes_; }
  [[nodiscard]] bool empty() const noexcept { return nodes_.empty(); }
  void clear() noexcept { nodes_.clear(); }

 private:
  std::map<NodeId, Node> nodes_;
};

}  // namespace rigor::world::store
