#include "sim/world/graph/snapshot.h"

#include <algorithm>
#include <unordered_set>

#include "sim/world/graph/same.h"
#include "sim/world/graph/snapshot_state.h"

namespace rigor::world {
namespace {

std::shared_ptr<const SnapshotState> empty_world() {
  static const auto state = [] {
    auto s = std::make_shared<SnapshotState>();
    s->layout = Layout::make(Schema(), nullptr);
    return std::shared_ptr<const SnapshotState>(s);
  }();
  return state;
}

}  // namespace

Snapshot::Snapshot() : state_(empty_world()) {}

const Schema& Snapshot::schema() const noexcept { return state_->layout->schema; }
std::uint64_t Snapshot::revision() const noexcept { return state_->world.revision; }

bool Snapshot::contains(NodeId node) const noexcept { return state_->world.location(node).is_there(); }

std::optional<TypeId> Snapshot::type_of(NodeId node) const noexcept {
  const Location l = state_->world.location(node);
  return l.is_there() ? std::optional(TypeId{l.type - 1}) : std::nullopt;
}

bool Snapshot::is_a(NodeId node, TypeId type) const noexcept {
  const Location l = state_->world.location(node);
  return l.is_there() && schema().is_a(TypeId{l.type - 1}, type);
}

std::size_t Snapshot::node_count() const noexcept { return state_->world.node_count; }

std::size_t Snapshot::count(TypeId type) const noexcept {
  if (type.value >= schema().type_count()) return 0;
  std::size_t n = 0;
  for (const TypeId t : schema().with_subtypes(type))
    if (const Table* table = state_->world.table(t.value)) n += table->size;
  return n;
}

const void* Snapshot::find(NodeId node, AttributeId attribute) const noexcept {
  return state_->layout->find(state_->world, node, attribute);
}

std::optional<Value> Snapshot::get(NodeId node, AttributeId attribute) const {
  const void* v = find(node, attribute);
  if (!v) return std::nullopt;
  return value_from(state_->layout->kinds[attribute.value], v);
}

std::optional<Value> Snapshot::get(NodeId node, std::string_view name) const {
  const auto t = type_of(node);
  if (!t) return std::nullopt;
  if (const auto a = schema().find_attribute(*t, name)) return get(node, *a);
  if (const DynamicMap* d = state_->world.dynamic_map(node))
    if (const auto it = d->values.find(name); it != d->values.end()) return it->second;
  return std::nullopt;
}

std::vector<std::pair<std::string, Value>> Snapshot::dynamic_attributes(NodeId node) const {
  if (const DynamicMap* d = state_->world.dynamic_map(node)) return {d->values.begin(), d->values.end()};
  return {};
}

void Snapshot::for_each(TypeId type, const std::function<void(NodeId)>& visit) const {
  if (type.value >= schema().type_count()) return;
  constexpr std::size_t kRows = std::size_t{1} << kShift<NodeId>;
  for (const TypeId t : schema().with_subtypes(type)) {
    const Table* table = state_->world.table(t.value);
    if (!table) continue;
    for (std::size_t row = 0; row < table->size; row += kRows) {
      const NodeId* ids = rigor::world::find<NodeId>(table->ids, row);
      const std::size_t n = std::min(kRows, table->size - row);
      for (std::size_t i = 0; i < n; ++i) visit(ids[i]);
    }
  }
}

std::vector<NodeId> Snapshot::nodes(TypeId type) const {
  std::vector<NodeId> all;
  all.reserve(count(type));
  for_each(type, [&](NodeId n) { all.push_back(n); });
  return all;
}

void Snapshot::scan_runs(TypeId type, AttributeId attribute,
                         const std::function<void(std::span<const NodeId>, const void*)>& visit) const {
  const Layout& layout = *state_->layout;
  if (type.value >= layout.types.size() || attribute.value >= layout.kinds.size()) return;
  const StoredKind kind = leaf_of(layout.kinds[attribute.value]);
  const LeafShape& shape = kLeafShapes[static_cast<std::size_t>(kind)];
  const std::size_t run = std::size_t{1} << std::min(shape.shift, kShift<NodeId>);
  const auto* defaults =
      reinterpret_cast<const std::byte*>(layout.filled[attribute.value].get()) + shape.offset;
  for (const TypeId t : layout.schema.with_subtypes(type)) {
    const std::uint16_t slot = layout.slot(t.value, attribute);
    const Table* table = state_->world.table(t.value);
    if (!table || slot == Layout::kNone) continue;
    const Array& column = table->column[slot];
    for (std::size_t row = 0; row < table->size; row += run) {
      const NodeId* ids = rigor::world::find<NodeId>(table->ids, row);
      const void* values = rigor::world::find(column, kind, row);
      visit({ids, std::min(run, table->size - row)}, values ? values : defaults);
    }
  }
}

std::vector<NodeId> Snapshot::find_equal(TypeId type, AttributeId attribute, const Value& value) const {
  std::vector<NodeId> found;
  if (attribute.value >= state_->layout->kinds.size() ||
      state_->layout->kinds[attribute.value] != kind_of(value))
    return found;
  std::visit(
      [&](const auto& wanted) {
        using T = std::decay_t<decltype(wanted)>;
        scan_runs(type, attribute, [&](std::span<const NodeId> ids, const void* values) {
          const T* v = static_cast<const T*>(values);
          for (std::size_t i = 0; i < ids.size(); ++i)
            if (same(v[i], wanted)) found.push_back(ids[i]);
        });
      },
      value);
  return found;
}

std::optional<NodeId> Snapshot::find_named(TypeId type, std::string_view name) const {
  const Layout& layout = *state_->layout;
  if (type.value >= layout.types.size()) return std::nullopt;
  constexpr std::size_t kRun = std::size_t{1} << std::min(kShift<std::string>, kShift<NodeId>);
  for (const TypeId t : layout.schema.with_subtypes(type)) {
    const Table* table = state_->world.table(t.value);
    const auto a = layout.schema.find_attribute(t, "name");
    if (!table || !a || layout.kinds[a->value] != ValueKind::text) continue;
    const Array& column = table->column[layout.slot(t.value, *a)];
    const auto* usual = static_cast<const std::string*>(layout.defaults[a->value]);
    for (std::size_t row = 0; row < table->size; row += kRun) {
      const auto* names = rigor::world::find<std::string>(column, row);
      const std::size_t n = std::min(kRun, table->size - row);
      for (std::size_t i = 0; i < n; ++i)
        if ((names ? names[i] : *usual) == name) return *rigor::world::find<NodeId>(table->ids, row + i);
    }
  }
  return std::nullopt;
}

std::span<const NodeId> Snapshot::targets(NodeId source, EdgeTypeId edge) const noexcept {
  return state_->world.neighbours(source, edge.value, false);
}
std::span<const NodeId> Snapshot::sources(NodeId target, EdgeTypeId edge) const noexcept {
  return state_->world.neighbours(target, edge.value, true);
}
NodeId Snapshot::target(NodeId source, EdgeTypeId edge) const noexcept {
  const auto t = targets(source, edge);
  return t.empty() ? NodeId{} : t[0];
}

std::vector<NodeId> Snapshot::follow(NodeId start, std::span<const Step> path) const {
  std::vector<NodeId> here, next;
  if (contains(start)) here.push_back(start);
  std::unordered_set<NodeId> seen;
  for (const Step& step : path) {
    next.clear();
    seen.clear();
    for (const NodeId n : here)
      for (const NodeId o : state_->world.neighbours(n, step.edge.value, step.backwards))
        if (seen.insert(o).second) next.push_back(o);
    here.swap(next);
  }
  return here;
}

Pose Snapshot::T_world_node(NodeId node, BenchTime t) const {
  const World& w = state_->world;
  const Layout& layout = *state_->layout;
  Pose T = Pose::Identity();
  // A ring of part_of (an edge type that is not acyclic) ends after as many steps as there are nodes.
  for (std::size_t steps = 0; node && steps <= w.node_count; ++steps) {
    const Location l = w.location(node);
    if (!l.is_there()) break;
    const auto& type = layout.types[l.type - 1];
    bool moves = type.motion != Layout::kNone;
    if (moves && type.moves != Layout::kNone)
      moves = *static_cast<const bool*>(layout.value(w, l, type.moves));
    else if (moves)
      moves = !same(*static_cast<const Motion*>(layout.value(w, l, type.motion)),
                    *static_cast<const Motion*>(layout.defaults[type.attributes[type.motion].value]));
    if (moves)
      T = static_cast<const Motion*>(layout.value(w, l, type.motion))->at(t) * T;
    else if (type.pose != Layout::kNone)
      T = *static_cast<const Pose*>(layout.value(w, l, type.pose)) * T;
    else if (type.position != Layout::kNone)
      T = Eigen::Translation3d(*static_cast<const Vector3*>(layout.value(w, l, type.position))) * T;
    node = target(node, layout.part_of);
  }
  return T;
}

}  // namespace rigor::world
