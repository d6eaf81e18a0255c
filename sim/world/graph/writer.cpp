#include "sim/world/graph/writer.h"

#include <algorithm>
#include <cstring>
#include <new>

#include "sim/world/graph/space_index.h"

namespace rigor::world {
namespace {

template <class T, class Item>
T* clone(Memory& m, T* old, StoredKind kind, std::uint32_t old_count, std::uint32_t count) {
  const std::size_t bytes = sizeof(T) + count * sizeof(Item);
  auto* n = static_cast<T*>(m.allocate(bytes));
  std::memset(static_cast<void*>(n), 0, bytes);
  if (old) {
    std::memcpy(static_cast<void*>(n), static_cast<const void*>(old), sizeof(T) + old_count * sizeof(Item));
    m.retire(old);
  }
  n->stamp = m.stamp(kind);
  return n;
}

}  // namespace

void Writer::fit_layout() {
  const auto type_count = static_cast<std::uint32_t>(layout->types.size());
  if (!world.tables || world.tables->count < type_count) {
    const std::uint32_t before = world.tables ? world.tables->count : 0;
    world.tables = clone<Tables, Table*>(memory_, world.tables, StoredKind::tables, before, type_count);
    world.tables->count = type_count;
  }
  const auto edge_count = static_cast<std::uint32_t>(layout->schema.edge_type_count());
  if (!world.edges || world.edges->count < edge_count) {
    const std::uint32_t before = world.edges ? world.edges->count : 0;
    world.edges = clone<Edges, EdgeTable>(memory_, world.edges, StoredKind::edges, before, edge_count);
    world.edges->count = edge_count;
  }
  for (std::uint32_t t = 0; t < type_count; ++t) {
    Table* old = world.tables->of[t];
    const auto columns = static_cast<std::uint32_t>(layout->types[t].attributes.size());
    if (!old || old->column_count == columns) continue;
    Tables* tables = my_tables();
    tables->of[t] = clone<Table, Array>(memory_, old, StoredKind::table, old->column_count, columns);
    tables->of[t]->column_count = columns;
  }
}

Tables* Writer::my_tables() {
  if (!memory_.is_mine(world.tables))
    world.tables = clone<Tables, Table*>(memory_, world.tables, StoredKind::tables, world.tables->count,
                                         world.tables->count);
  return world.tables;
}

Edges* Writer::my_edges() {
  if (!memory_.is_mine(world.edges))
    world.edges = clone<Edges, EdgeTable>(memory_, world.edges, StoredKind::edges, world.edges->count,
                                          world.edges->count);
  return world.edges;
}

Table* Writer::my_table(std::uint32_t type) {
  Table*& slot = my_tables()->of[type];
  if (!slot) {
    const auto columns = static_cast<std::uint32_t>(layout->types[type].attributes.size());
    slot = clone<Table, Array>(memory_, static_cast<Table*>(nullptr), StoredKind::table, 0, columns);
    slot->column_count = columns;
  } else if (!memory_.is_mine(slot)) {
    slot = clone<Table, Array>(memory_, slot, StoredKind::table, slot->column_count, slot->column_count);
  }
  return slot;
}

void Writer::create(NodeId node, std::uint32_t type) {
  Table* t = my_table(type);
  const std::size_t row = t->size++;
  edit<NodeId>(memory_, t->ids, StoredKind::ids, row) = node;
  edit<Location>(memory_, world.locations, StoredKind::locations, node.value) = {
      type + 1, static_cast<std::uint32_t>(row)};
  ++world.node_count;
  if (layout->types[type].place != Layout::kNone) {
    unsettled_.push_back(node);
    if (node.value < settled_below_) unsettled_low_.insert(node);
  }
  if (node.value >= world.next_id) world.next_id = node.value + 1;
  if (log) log->ops.push_back({.kind = OpKind::create, .type = type, .node = node});
}

void Writer::remove(NodeId node, bool never_was) {
  const Location l = world.location(node);
  const std::uint32_t type = l.type - 1;
  Table* t = my_table(type);
  const auto& attributes = layout->types[type].attributes;
  if (log) {
    OldNode old;
    for (std::uint16_t s = 0; s < t->column_count; ++s) {
      const ValueKind kind = layout->kinds[attributes[s].value];
      const void* v = find(t->column[s], leaf_of(kind), l.row);
      if (v && !leaf_ops(leaf_of(kind)).same(v, layout->defaults[attributes[s].value]))
        old.values.emplace_back(attributes[s], value_from(kind, v));
    }
    if (const DynamicMap* d = world.dynamic_map(node)) old.dynamic = d->values;
    log->nodes.push_back(std::move(old));
    log->ops.push_back({.kind = OpKind::remove, .type = type, .node = node, .other = log->nodes.size() - 1});
  }
  if (DynamicMap* const d = const_cast<DynamicMap*>(world.dynamic_map(node))) {
    edit<DynamicMap*>(memory_, world.dynamics, StoredKind::dynamics, node.value) = nullptr;
    memory_.retire(d);
  }
  if (layout->types[type].place != Layout::kNone) {
    Vector3 p;
    if (!is_settled(node))
      unsettled_low_.erase(node);
    else if (layout->place(world, node, l, p))
      space_remove(memory_, t->space, {p.x(), p.y(), p.z(), node});
  }
  // The last row moves into the gap, and its own place becomes a row of defaults.
  const std::size_t last = t->size - 1;
  for (std::uint16_t s = 0; s < t->column_count; ++s) {
    const ValueKind kind = layout->kinds[attributes[s].value];
    const StoredKind stored = leaf_of(kind);
    const LeafOps& ops = leaf_ops(stored);
    const void* usual = layout->defaults[attributes[s].value];
    const void* moving = find(t->column[s], stored, last);
    if (last != l.row && (moving || find(t->column[s], stored, l.row))) {
      void* gap = edit(memory_, t->column[s], stored, l.row, usual);
      moving = find(t->column[s], stored, last);  // edit may have copied the leaf that both share
      ops.assign(gap, moving ? moving : usual);
    }
    if ((last & ((std::size_t{1} << ops.shift) - 1)) == 0)
      drop_leaf(memory_, t->column[s], stored, last);
    else if (moving && !ops.same(moving, usual))
      ops.assign(edit(memory_, t->column[s], stored, last, usual), usual);
  }
  if (last != l.row) {
    const NodeId moved = *find<NodeId>(t->ids, last);
    edit<NodeId>(memory_, t->ids, StoredKind::ids, l.row) = moved;
    edit<Location>(memory_, world.locations, StoredKind::locations, moved.value).row = l.row;
  }
  if ((last & ((std::size_t{1} << kShift<NodeId>)-1)) == 0) drop_leaf(memory_, t->ids, StoredKind::ids, last);
  t->size = last;
  edit<Location>(memory_, world.locations, StoredKind::locations, node.value) = {
      never_was ? 0 : Location::kGone, 0};
  --world.node_count;
}

void Writer::set(NodeId node, Location l, std::uint16_t slot, const void* value, bool is_new) {
  const AttributeId a = layout->types[l.type - 1].attributes[slot];
  const ValueKind kind = layout->kinds[a.value];
  Table* const t = my_table(l.type - 1);
  Array& column = t->column[slot];
  const void* usual = layout->defaults[a.value];
  if (log && !is_new) {
    const void* old = find(column, leaf_of(kind), l.row);
    log->ops.push_back({.kind = OpKind::set,
                        .value_kind = kind,
                        .what = a.value,
                        .type = l.type - 1,
                        .node = node,
                        .other = log->keep(kind, old ? old : usual)});
  }
  const bool moves = slot == layout->types[l.type - 1].place && is_settled(node);
  Vector3 before, after;
  const bool was = moves && layout->place(world, node, l, before);
  leaf_ops(leaf_of(kind)).assign(edit(memory_, column, leaf_of(kind), l.row, usual), value);
  if (!moves) return;
  const bool is = layout->place(world, node, l, after);
  const SpaceEntry from{before.x(), before.y(), before.z(), node}, to{after.x(), after.y(), after.z(), node};
  if (was && is)
    space_move(memory_, t->space, from, to);
  else if (was)
    space_remove(memory_, t->space, from);
  else if (is)
    space_insert(memory_, t->space, to);
}

void Writer::settle_places() {
  if (!unsettled_.empty()) {
    std::vector<std::vector<SpaceEntry>> entries(layout->types.size());
    std::sort(unsettled_.begin(), unsettled_.end());
    unsettled_.erase(std::unique(unsettled_.begin(), unsettled_.end()), unsettled_.end());
    for (const NodeId n : unsettled_) {
      const Location l = world.location(n);
      Vector3 p;
      if (l.is_there() && layout->place(world, n, l, p))
        entries[l.type - 1].push_back({p.x(), p.y(), p.z(), n});
    }
    for (std::uint32_t t = 0; t < entries.size(); ++t)
      if (!entries[t].empty()) space_insert(memory_, my_table(t)->space, entries[t]);
    if (unsettled_.capacity() > 4096) std::vector<NodeId>().swap(unsettled_);
    unsettled_.clear();
    unsettled_low_.clear();
  }
  settled_below_ = world.next_id;
}

void Writer::part_of_changes(NodeId source, bool connects) {
  const Location l = world.location(source);
  const auto& type = layout->types[l.type - 1];
  if (type.place == Layout::kNone || type.place_kind == ValueKind::vector3 || !is_settled(source)) return;
  Vector3 p;
  if (!layout->place(world, source, l, p)) return;  // it has a parent still
  Table* t = my_table(l.type - 1);
  const SpaceEntry e{p.x(), p.y(), p.z(), source};
  if (connects)
    space_remove(memory_, t->space, e);
  else
    space_insert(memory_, t->space, e);
}

void Writer::set_dynamic(NodeId node, std::uint32_t type, std::string_view name, const Value* value,
                         bool is_new) {
  DynamicMap*& slot = edit<DynamicMap*>(memory_, world.dynamics, StoredKind::dynamics, node.value);
  if (log && !is_new) {
    OldDynamic old{std::string(name), std::nullopt};
    if (slot)
      if (const auto it = slot->values.find(name); it != slot->values.end()) old.value = it->second;
    log->dynamics.push_back(std::move(old));
    log->ops.push_back(
        {.kind = OpKind::set_dynamic, .type = type, .node = node, .other = log->dynamics.size() - 1});
  }
  if (!slot || !memory_.is_mine(slot)) {
    auto* map = new (memory_.allocate(sizeof(DynamicMap))) DynamicMap;
    map->stamp = memory_.stamp(StoredKind::dynamic_map);
    if (slot) {
      map->values = slot->values;
      memory_.retire(slot);
    }
    slot = map;
  }
  if (value)
    slot->values.insert_or_assign(std::string(name), *value);
  else if (const auto it = slot->values.find(name); it != slot->values.end())
    slot->values.erase(it);
  if (slot->values.empty()) {
    memory_.retire(slot);
    slot = nullptr;
  }
}

void Writer::insert(Array& lists, NodeId at, std::uint32_t index, NodeId value) {
  NodeList& l = edit<NodeList>(memory_, lists, StoredKind::lists, at.value);
  const auto size = static_cast<std::uint32_t>(l.size);
  index = std::min(index, size);
  if (size == 0) {
    l.one = value;
    l.size = 1;
    return;
  }
  Block* old = size > 1 ? l.block : nullptr;
  const NodeId first = l.one;
  const bool at_end = index == size;
  Block* b = old;
  // Beyond what it uses, a block is the writer's alone; before that, only where no snapshot has it.
  if (!old || size == old->capacity || (!memory_.is_mine(old) && (!at_end || old->used != size))) {
    const std::uint32_t capacity = size < 4 ? 4 : size + size / 2;
    b = static_cast<Block*>(memory_.allocate(sizeof(Block) + capacity * sizeof(NodeId)));
    b->stamp = memory_.stamp(StoredKind::block);
    b->capacity = capacity;
    if (old) {
      std::copy_n(old->ids, size, b->ids);
      memory_.retire(old);
    } else {
      b->ids[0] = first;
    }
  }
  if (!at_end) std::copy_backward(b->ids + index, b->ids + size, b->ids + size + 1);
  b->ids[index] = value;
  b->used = size + 1;
  l.block = b;
  l.size = size + 1;
}

void Writer::erase(Array& lists, NodeId at, std::uint32_t index) {
  NodeList& l = edit<NodeList>(memory_, lists, StoredKind::lists, at.value);
  const auto size = static_cast<std::uint32_t>(l.size);
  if (size == 1) {
    l.size = 0;
    l.block = nullptr;
    return;
  }
  Block* old = l.block;
  if (size == 2) {
    const NodeId left = old->ids[1 - index];
    memory_.retire(old);
    l.one = left;
    l.size = 1;
    return;
  }
  if (index + 1 == size) {  // others may go on seeing the last; it is written over only in a copy
    l.size = size - 1;
    return;
  }
  Block* b = old;
  if (!memory_.is_mine(old)) {
    b = static_cast<Block*>(memory_.allocate(sizeof(Block) + old->capacity * sizeof(NodeId)));
    b->stamp = memory_.stamp(StoredKind::block);
    b->capacity = old->capacity;
    std::copy_n(old->ids, size, b->ids);
    memory_.retire(old);
    l.block = b;
  }
  std::copy(b->ids + index + 1, b->ids + size, b->ids + index);
  b->used = size - 1;
  l.size = size - 1;
}

void Writer::connect(NodeId source, EdgeTypeId edge, NodeId target, std::uint32_t at_out,
                     std::uint32_t at_in) {
  if (edge == layout->part_of) part_of_changes(source, true);
  EdgeTable& t = my_edges()->of[edge.value];
  insert(t.out, source, at_out, target);
  insert(t.in, target, at_in, source);
  ++t.count;
  if (log)
    log->ops.push_back({.kind = OpKind::connect,
                        .what = edge.value,
                        .type = world.location(source).type - 1,
                        .node = source,
                        .other = target.value});
}

void Writer::disconnect(NodeId source, EdgeTypeId edge, NodeId target) {
  EdgeTable& t = my_edges()->of[edge.value];
  const auto index = [](std::span<const NodeId> list, NodeId n) {
    // From the end: what was connected last is taken back first.
    for (std::size_t i = list.size(); i > 0; --i)
      if (list[i - 1] == n) return static_cast<std::uint32_t>(i - 1);
    return std::uint32_t{0};
  };
  const std::uint32_t at_out = index(world.neighbours(source, edge.value, false), target);
  const std::uint32_t at_in = index(world.neighbours(target, edge.value, true), source);
  erase(t.out, source, at_out);
  erase(t.in, target, at_in);
  --t.count;
  if (edge == layout->part_of) part_of_changes(source, false);
  if (log)
    log->ops.push_back({.kind = OpKind::disconnect,
                        .what = edge.value,
                        .type = world.location(source).type - 1,
                        .node = source,
                        .other = target.value,
                        .at_out = at_out,
                        .at_in = at_in});
}

void Writer::invert(const Log& from, std::size_t i, bool never_was) {
  const Op op = from.ops[i];
  switch (op.kind) {
    case OpKind::create:
      remove(op.node, never_was);
      break;
    case OpKind::remove: {
      create(op.node, op.type);
      const OldNode& old = from.nodes[op.other];
      const Location l = world.location(op.node);
      for (const auto& [a, v] : old.values)
        set(op.node, l, layout->slot(op.type, a),
            std::visit([](const auto& x) -> const void* { return &x; }, v), true);
      for (const auto& [name, v] : old.dynamic) set_dynamic(op.node, op.type, name, &v, true);
      break;
    }
    case OpKind::set:
      set(op.node, world.location(op.node), layout->slot(op.type, AttributeId{op.what}),
          from.kept(op.value_kind, op.other), false);
      break;
    case OpKind::set_dynamic: {
      const OldDynamic& old = from.dynamics[op.other];
      set_dynamic(op.node, op.type, old.name, old.value ? &*old.value : nullptr, false);
      break;
    }
    case OpKind::connect:
      disconnect(op.node, EdgeTypeId{op.what}, NodeId{op.other});
      break;
    case OpKind::disconnect:
      connect(op.node, EdgeTypeId{op.what}, NodeId{op.other}, op.at_out, op.at_in);
      break;
  }
}

}  // namespace rigor::world
