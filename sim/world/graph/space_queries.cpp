#include <algorithm>
#include <cmath>

#include "sim/world/graph/snapshot.h"
#include "sim/world/graph/snapshot_state.h"
#include "sim/world/graph/space_index.h"

namespace rigor::world {
namespace {

/// The trees of a type and its subtypes.
std::vector<const Stored*> trees(const Snapshot& s, TypeId type) {
  std::vector<const Stored*> roots;
  if (type.value >= s.schema().type_count()) return roots;
  for (const TypeId t : s.schema().with_subtypes(type))
    if (const Table* table = s.state().world.table(t.value); table && table->space)
      roots.push_back(table->space);
  return roots;
}

std::vector<NodeId> ids_of(const std::vector<std::pair<double, NodeId>>& found) {
  std::vector<NodeId> ids;
  ids.reserve(found.size());
  for (const auto& [d, n] : found) ids.push_back(n);
  return ids;
}

}  // namespace

std::vector<NodeId> Snapshot::in_box(TypeId type, const Box3& box) const {
  std::vector<NodeId> ids;
  for (const Stored* root : trees(*this, type)) space_in_box(root, box, ids);
  std::sort(ids.begin(), ids.end());
  return ids;
}

std::vector<NodeId> Snapshot::in_radius(TypeId type, const Vector3& centre, double radius_m) const {
  if (!centre.allFinite() || !(radius_m >= 0)) return {};
  std::vector<std::pair<double, NodeId>> found;
  for (const Stored* root : trees(*this, type)) space_in_radius(root, centre, radius_m, found);
  std::sort(found.begin(), found.end());
  return ids_of(found);
}

std::vector<NodeId> Snapshot::nearest(TypeId type, const Vector3& centre, std::size_t k) const {
  if (!centre.allFinite()) return {};
  return ids_of(space_nearest(trees(*this, type), centre, k));
}

}  // namespace rigor::world
