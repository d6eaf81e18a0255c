// The one place of an import that writes to the world.
#pragma once

#include "sim/gis/draft.h"
#include "sim/world/graph/database.h"

namespace rigor::gis {

/// All nodes in one transaction; on an error the world is as it was. Errors: bad_input (a rule's veto).
[[nodiscard]] Status write_draft(world::Database& db, const std::vector<DraftNode>& nodes,
                                 const std::string& label);

}  // namespace rigor::gis
