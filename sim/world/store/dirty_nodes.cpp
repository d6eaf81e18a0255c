#include "sim/world/store/dirty_nodes.h"

#include <algorithm>

namespace rigor::world::store {

void DirtyNodes::note(const ChangeSet& set, std::span<const Change> changes) {
  const auto& schema = set.after.schema();
  for (const auto& c : changes) {
    switch (c.kind) {
      case ChangeKind::created:
      case ChangeKind::removed:
        nodes_[c.node].whole = true;
        break;
      case ChangeKind::changed:
        if (c.attribute == AttributeId{})
          nodes_[c.node].dynamic = true;
        else if (!schema.attribute(c.attribute).spec.transient)
          nodes_[c.node].attributes.insert(c.attribute);
        break;
      case ChangeKind::connected:
      case ChangeKind::disconnected:
        nodes_[c.node].edges.insert(c.edge);
        break;
    }
  }
}

void DirtyNodes::note_all(const Snapshot& world) {
  world.for_each(TypeId{}, [&](NodeId node) { nodes_[node].whole = true; });
}

void DirtyNodes::note_difference(const Snapshot& before, const Snapshot& after) {
  const auto& schema = after.schema();
  before.for_each(TypeId{}, [&](NodeId node) {
    if (!after.contains(node)) nodes_[node].whole = true;
  });
  after.for_each(TypeId{}, [&](NodeId node) {
    if (before.type_of(node) != after.type_of(node)) {
      nodes_[node].whole = true;
      return;
    }
    for (const auto a : schema.attributes(*after.type_of(node)))
      if (!schema.attribute(a).spec.transient && !same_value(*before.get(node, a), *after.get(node, a)))
        nodes_[node].attributes.insert(a);
    const auto was = before.dynamic_attributes(node), is = after.dynamic_attributes(node);
    if (!std::equal(was.begin(), was.end(), is.begin(), is.end(), [](const auto& x, const auto& y) {
          return x.first == y.first && same_value(x.second, y.second);
        }))
      nodes_[node].dynamic = true;
    for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e) {
      const auto x = before.targets(node, EdgeTypeId{e}), y = after.targets(node, EdgeTypeId{e});
      if (!std::equal(x.begin(), x.end(), y.begin(), y.end())) nodes_[node].edges.insert(EdgeTypeId{e});
    }
  });
}

}  // namespace rigor::world::store
