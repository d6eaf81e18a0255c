// Where the ground became another: what stands on it elsewhere need not be looked at.
#pragma once

#include <Eigen/Geometry>

#include "sim/world/graph/snapshot.h"

namespace rigor::nature::built {

/// World x and y of all ground that the change of a Terrain node may have moved; empty: none.
[[nodiscard]] Eigen::AlignedBox2d changed_ground(const world::Snapshot& before, const world::Snapshot& after,
                                                 world::NodeId terrain);

}  // namespace rigor::nature::built
