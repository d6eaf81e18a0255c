// From the steps of a transaction to its net effects.
#pragma once

#include <vector>

#include "sim/world/graph/changes.h"
#include "sim/world/graph/log.h"
#include "sim/world/graph/snapshot_state.h"

namespace rigor::world {

/// The net effects of the steps from `first` on, up to the world as it is now, in the order in which nodes,
/// attributes and edges were first touched.
[[nodiscard]] std::vector<Change> net_changes(const World& now, const Layout& layout, const Log& log,
                                              std::size_t first = 0);

}  // namespace rigor::world
