// A tree of the world as it is shown: which prototypes, how scaled and turned; and where its stem is at some
// height, as a surveyor measures it.
//
//   const auto section = stem_section(snapshot, tree, node, 1.0);     // a metre above the foot
#pragma once

#include <optional>

#include "sim/nature/trees/tree_mesh.h"
#include "sim/world/semantic_types.h"

namespace rigor::nature {

struct ShownTree {
  const Species* species = nullptr;  ///< never null
  bool known = true;                 ///< false: `species` is a generic one
  TreeSize size{};
  bool dead = false;
  int age_class = 0;
  render::Instance upright;  ///< turned about z and lit, as crown and trunk are; not scaled
  float light = 1;
  TrunkKey trunk;
  render::Instance stem;  ///< of the trunk's prototype, its foot at the origin
};
/// By the tree's attributes and its id. Any thread.
[[nodiscard]] ShownTree shown_tree(const world::Snapshot& world, const world::types::Tree& types,
                                   world::NodeId node);

struct StemSection {
  double x_m = 0, y_m = 0;  ///< world frame: its middle
  double diameter_m = 0;    ///< mean
};
/// The stem, without branches, cut level at a height above its foot. Empty where it has no place or does not
/// reach so high.
[[nodiscard]] std::optional<StemSection> stem_section(const world::Snapshot& world,
                                                      const world::types::Tree& types, world::NodeId node,
                                                      double height_m);

}  // namespace rigor::nature
