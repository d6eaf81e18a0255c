#include <algorithm>
#include <cmath>

#include "sim/world/graph/snapshot.h"
#include "sim/world/graph/snapshot_state.h"

namespace rigor::world {
namespace {

template <class Visit>
void each_place(const Snapshot& s, TypeId type, const Visit& visit) {
  const auto& state = s.state();
  s.for_each(type, [&](NodeId n) {
    Vector3 p;
    if (state.layout->place(state.world, n, state.world.location(n), p)) visit(n, p);
  });
}

using Found = std::vector<std::pair<double, NodeId>>;

std::vector<NodeId> nearest_first(Found found, std::size_t k) {
  std::sort(found.begin(), found.end());
  std::vector<NodeId> ids;
  for (std::size_t i = 0; i < std::min(k, found.size()); ++i) ids.push_back(found[i].second);
  return ids;
}

}  // namespace

std::vector<NodeId> Snapshot::in_box(TypeId type, const Box3& box) const {
  std::vector<NodeId> ids;
  each_place(*this, type, [&](NodeId n, const Vector3& p) {
    if ((p.array() >= box.min.array()).all() && (p.array() <= box.max.array()).all()) ids.push_back(n);
  });
  std::sort(ids.begin(), ids.end());
  return ids;
}

std::vector<NodeId> Snapshot::in_radius(TypeId type, const Vector3& centre, double radius_m) const {
  Found found;
  each_place(*this, type, [&](NodeId n, const Vector3& p) {
    const double d = (p - centre).norm();
    if (d <= radius_m) found.emplace_back(d, n);
  });
  const std::size_t n = found.size();
  return nearest_first(std::move(found), n);
}

std::vector<NodeId> Snapshot::nearest(TypeId type, const Vector3& centre, std::size_t k) const {
  Found found;
  if (!centre.allFinite()) return {};
  each_place(*this, type, [&](NodeId n, const Vector3& p) { found.emplace_back((p - centre).norm(), n); });
  return nearest_first(std::move(found), k);
}

}  // namespace rigor::world
