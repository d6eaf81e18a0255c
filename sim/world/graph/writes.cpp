// The writes of a transaction: what is asked for is checked, then handed to the writer.
#include <algorithm>
#include <unordered_set>

#include "sensor-hal/config/yaml.h"
#include "sim/world/graph/check_value.h"
#include "sim/world/graph/database_state.h"

namespace rigor::world {
namespace {

tl::unexpected<Error> bad_write(std::string where, std::string message) {
  return fail(ErrorCode::bad_input, std::move(where), std::move(message));
}

}  // namespace

std::string DatabaseState::name_of(NodeId node) const {
  const Location l = writer.world.location(node);
  return (l.is_there() ? schema.type(TypeId{l.type - 1}).name : "node") + "#" + std::to_string(node.value);
}

std::string DatabaseState::name_of(NodeId node, AttributeId a) const {
  return name_of(node) + "." +
         (a.value < schema.attribute_count() ? schema.attribute(a).spec.name
                                             : "attribute " + std::to_string(a.value));
}

Result<NodeId> DatabaseState::create(NodeId wanted, TypeId type) {
  if (type.value >= schema.type_count())
    return bad_write("", "no node type has the number " + std::to_string(type.value));
  if (writer.layout->types[type.value].abstract)
    return bad_write(schema.type(type).name, "the type is abstract: make a node of one of its subtypes");
  if (auto s = may_create(type); !s) return tl::unexpected(s.error());
  if (wanted) {
    if (wanted.value >> 62)
      return bad_write(schema.type(type).name + "#" + std::to_string(wanted.value),
                       "node ids are below 2^62");
    const Location l = writer.world.location(wanted);
    if (l.type != 0)
      return bad_write(name_of(wanted), l.is_there()
                                            ? "the id is taken"
                                            : "the id was that of a node that has been removed; ids are "
                                              "never used again");
    if (wanted.value < first_new) low_new.insert(wanted);
  }
  const NodeId id = wanted ? wanted : NodeId{writer.world.next_id};
  writer.create(id, type.value);
  return id;
}

Status DatabaseState::remove(NodeId node) {
  if (!writer.world.location(node).is_there())
    return bad_write(name_of(node), "there is no such node to remove");
  // The node and all that go with it, the farthest last.
  std::vector<NodeId> going{node};
  std::unordered_set<NodeId> known{node};
  for (std::size_t i = 0; i < going.size(); ++i)
    for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e)
      if (schema.edge(EdgeTypeId{e}).removes_sources)
        for (const NodeId s : writer.world.neighbours(going[i], e, true))
          if (known.insert(s).second) going.push_back(s);
  if (running)
    for (const NodeId n : going)
      if (auto s = may_create(TypeId{writer.world.location(n).type - 1}); !s) return s;
  for (auto it = going.rbegin(); it != going.rend(); ++it) {
    for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e) {
      for (auto out = writer.world.neighbours(*it, e, false); !out.empty();
           out = writer.world.neighbours(*it, e, false))
        writer.disconnect(*it, EdgeTypeId{e}, out.back());
      for (auto in = writer.world.neighbours(*it, e, true); !in.empty();
           in = writer.world.neighbours(*it, e, true))
        writer.disconnect(in.back(), EdgeTypeId{e}, *it);
    }
    writer.remove(*it);
  }
  return {};
}

Status DatabaseState::set(NodeId node, AttributeId a, ValueKind kind, const void* value) {
  const Layout& layout = *writer.layout;
  const Location l = writer.world.location(node);
  if (!l.is_there()) return bad_write(name_of(node, a), "there is no such node");
  const std::uint16_t slot = layout.slot(l.type - 1, a);
  if (slot == Layout::kNone)
    return bad_write(name_of(node, a), "the attribute belongs to another type" +
                                           (a.value < schema.attribute_count()
                                                ? ", " + schema.type(schema.attribute(a).owner).name
                                                : std::string()));
  if (layout.kinds[a.value] != kind)
    return bad_write(name_of(node, a), "expected a value of kind " +
                                           std::string(world::name_of(layout.kinds[a.value])) +
                                           ", got one of kind " + std::string(world::name_of(kind)));
  if (layout.limited[a.value])
    if (auto wrong = check_value(layout.schema.attribute(a).spec, value))
      return bad_write(name_of(node, a), *wrong);
  if (running)
    if (auto s = may_write(a); !s) return s;
  if (leaf_ops(leaf_of(kind)).same(layout.value(writer.world, l, slot), value)) return {};
  writer.set(node, l, slot, value, is_new(node));
  return {};
}

Status DatabaseState::set_dynamic(NodeId node, std::string_view name, const Value* value) {
  const Location l = writer.world.location(node);
  const std::string where = name_of(node) + "." + std::string(name);
  if (!l.is_there()) return bad_write(where, "there is no such node");
  if (name.empty()) return bad_write(where, "a dynamic attribute needs a name");
  if (schema.find_attribute(TypeId{l.type - 1}, name))
    return bad_write(where, "the type has an attribute of this name, which is not dynamic");
  const DynamicMap* map = writer.world.dynamic_map(node);
  const auto it = map ? map->values.find(name) : decltype(map->values.end()){};
  const bool is_there = map && it != map->values.end();
  if (!value && !is_there) {
    std::vector<std::string> names;
    if (map)
      for (const auto& [n, v] : map->values) names.push_back(n);
    const std::string near = nearest(name, names);
    return bad_write(where, "the node has no dynamic attribute of this name" +
                                (near.empty() ? "" : "; did you mean '" + near + "'?"));
  }
  if (value && is_there && same_value(it->second, *value)) return {};
  writer.set_dynamic(node, l.type - 1, name, value, is_new(node));
  return {};
}

namespace {

bool has_edge(const World& w, NodeId source, EdgeTypeId edge, NodeId target) {
  const auto out = w.neighbours(source, edge.value, false);
  const auto in = w.neighbours(target, edge.value, true);
  return out.size() <= in.size() ? std::find(out.begin(), out.end(), target) != out.end()
                                 : std::find(in.begin(), in.end(), source) != in.end();
}

/// Whether edges of the type lead from `from` to `to`.
bool leads_to(const World& w, EdgeTypeId edge, NodeId from, NodeId to) {
  std::vector<NodeId> stack{from};
  std::unordered_set<NodeId> seen;
  while (!stack.empty()) {
    const NodeId n = stack.back();
    stack.pop_back();
    if (n == to) return true;
    const auto next = w.neighbours(n, edge.value, false);
    if (next.size() == 1 && stack.empty() && seen.empty()) {  // a chain: acyclic already, nothing to note
      stack.push_back(next[0]);
      continue;
    }
    if (!seen.insert(n).second) continue;
    stack.insert(stack.end(), next.begin(), next.end());
  }
  return false;
}

}  // namespace

Status DatabaseState::connect(NodeId source, EdgeTypeId edge, NodeId target) {
  if (edge.value >= schema.edge_type_count())
    return bad_write("", "no edge type has the number " + std::to_string(edge.value));
  const EdgeSpec& spec = schema.edge(edge);
  const World& w = writer.world;
  const auto where = [&] { return name_of(source) + " " + spec.name + " " + name_of(target); };
  const Location from = w.location(source), to = w.location(target);
  if (!from.is_there()) return bad_write(where(), "there is no such source node");
  if (!to.is_there()) return bad_write(where(), "there is no such target node");
  const Layout::Ends& ends = writer.layout->ends[edge.value];
  if (!schema.is_a(TypeId{from.type - 1}, ends.from))
    return bad_write(where(), "expected a source of type " + spec.from);
  if (!schema.is_a(TypeId{to.type - 1}, ends.to))
    return bad_write(where(), "expected a target of type " + spec.to);
  if (running)
    if (auto s = may_connect(edge); !s) return s;
  if (has_edge(w, source, edge, target)) return {};
  if (spec.targets_per_source == Cardinality::one)
    if (const auto t = w.neighbours(source, edge.value, false); !t.empty())
      return bad_write(where(), "the source may have one target only and has " + name_of(t[0]) +
                                    ": disconnect that first");
  if (spec.sources_per_target == Cardinality::one)
    if (const auto s = w.neighbours(target, edge.value, true); !s.empty())
      return bad_write(where(), "the target may have one source only and has " + name_of(s[0]) +
                                    ": disconnect that first");
  if (spec.acyclic && leads_to(w, edge, target, source))
    return bad_write(where(), "this would close a ring, and " + spec.name + " allows none");
  writer.connect(source, edge, target);
  return {};
}

Status DatabaseState::disconnect(NodeId source, EdgeTypeId edge, NodeId target) {
  if (edge.value >= schema.edge_type_count())
    return bad_write("", "no edge type has the number " + std::to_string(edge.value));
  if (running)
    if (auto s = may_connect(edge); !s) return s;
  if (!has_edge(writer.world, source, edge, target))
    return bad_write(name_of(source) + " " + schema.edge(edge).name + " " + name_of(target),
                     "they are not connected");
  writer.disconnect(source, edge, target);
  return {};
}

}  // namespace rigor::world
