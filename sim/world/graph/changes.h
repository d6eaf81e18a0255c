// What one transaction did, in the form in which subscribers get it: net effects, each once, in order.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "sim/world/graph/schema.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::world {

enum class ChangeKind : std::uint8_t { created, changed, removed, connected, disconnected };

/// One net effect. A node that a transaction both made and removed appears not at all; an attribute set
/// twice, once; one set to the value that it had, not at all. A created node has no `changed` entries for its
/// first values.
struct Change {
  ChangeKind kind = ChangeKind::changed;
  NodeId node;
  TypeId type;
  AttributeId attribute{};   ///< of `changed`; invalid for a dynamic attribute
  EdgeTypeId edge{};         ///< of connected and disconnected: node is the source
  NodeId other{};            ///< the target
  std::string dynamic = {};  ///< name of a dynamic attribute
};

struct ChangeSet {
  std::uint64_t revision = 0;
  std::string label = {};       ///< of the transaction; "undo: …" and "redo: …"
  std::vector<Change> changes;  ///< in the order in which the transaction first touched them
  Snapshot before, after;       ///< removed nodes are read from `before`
};

}  // namespace rigor::world
