// What the crown generators share. For sim/nature/trees alone.
#pragma once

#include <vector>

#include "sim/nature/trees/draws.h"
#include "sim/nature/trees/mesh_builder.h"
#include "sim/nature/trees/tree_mesh.h"

namespace rigor::nature {

inline constexpr int kCrownLevels = 5;

/// A crown before its levels are made into a prototype.
struct CrownMeshes {
  std::vector<std::shared_ptr<const render::Mesh>> levels;  ///< finest first
  std::vector<float> half_width_m;                          ///< of each level's cards, mean
  float length_m = 1;
};
[[nodiscard]] CrownMeshes make_conifer_crown(const CrownKey& key);
[[nodiscard]] CrownMeshes make_broadleaf_crown(const CrownKey& key);
/// Height, crown length and radius of the tree that a prototype shows.
struct ClassSize {
  float height_m, crown_m, radius_m;
};
[[nodiscard]] ClassSize class_size(TreeForm form, int age_class) noexcept;

}  // namespace rigor::nature
