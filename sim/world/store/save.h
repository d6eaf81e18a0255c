// From a snapshot into the tables of a file, at the cost of what changed.
#pragma once

#include "sim/world/graph/snapshot.h"
#include "sim/world/store/dirty_nodes.h"
#include "sim/world/store/sqlite.h"
#include "sim/world/store/tables.h"

namespace rigor::world::store {

/// Within the transaction that is open. Gives the same tables whether or not an earlier write of the same
/// changes reached the file.
void save(Sqlite& sql, const FileNumbers& numbers, const Snapshot& world, const DirtyNodes& dirty);

}  // namespace rigor::world::store
