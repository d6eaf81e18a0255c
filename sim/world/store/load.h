// From the tables of a file into a database without nodes.
#pragma once

#include <filesystem>

#include "rt-core/result.h"
#include "sim/world/graph/database.h"
#include "sim/world/store/dirty_nodes.h"
#include "sim/world/store/sqlite.h"

namespace rigor::world::store {

/// Defines types, loads and commits. `dirty` gets what rules then made different from the file.
[[nodiscard]] Status load(Sqlite& sql, Database& db, const std::filesystem::path& file, DirtyNodes& dirty);

/// Makes the next node that `tx` creates have at least this id.
[[nodiscard]] Status skip_ids(Transaction& tx, NodeId next);

}  // namespace rigor::world::store
