// The database as one would write it without a thought for speed: maps that are copied whole.
#pragma once

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "sim/world/graph/database.h"

namespace rigor::world::testing_model {

struct ModelNode {
  TypeId type;
  std::map<std::uint32_t, Value> values;  // by attribute, all of them
  std::map<std::string, Value> dynamic;
};

inline bool same_map(const auto& a, const auto& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) {
    return x.first == y.first && same_value(x.second, y.second);
  });
}

struct Model {
  const Schema* schema = nullptr;
  std::map<NodeId, ModelNode> nodes;
  // targets and sources in the order in which they were connected
  std::map<std::pair<std::uint32_t, NodeId>, std::vector<NodeId>> out, in;

  bool has(NodeId n) const { return nodes.contains(n); }
  std::vector<NodeId> targets(std::uint32_t e, NodeId n) const {
    const auto it = out.find({e, n});
    return it == out.end() ? std::vector<NodeId>{} : it->second;
  }
  std::vector<NodeId> sources(std::uint32_t e, NodeId n) const {
    const auto it = in.find({e, n});
    return it == in.end() ? std::vector<NodeId>{} : it->second;
  }
  bool connected(NodeId s, std::uint32_t e, NodeId t) const {
    const auto list = targets(e, s);
    return std::find(list.begin(), list.end(), t) != list.end();
  }
  void create(NodeId id, TypeId type) {
    ModelNode n{type, {}, {}};
    for (const AttributeId a : schema->attributes(type))
      n.values[a.value] = schema->attribute(a).spec.default_value;
    nodes[id] = n;
  }
  static void take_out(auto& lists, std::uint32_t e, NodeId at, NodeId which) {
    auto& l = lists[{e, at}];
    l.erase(std::find(l.begin(), l.end(), which));
    if (l.empty()) lists.erase({e, at});
  }
  void cut(NodeId s, std::uint32_t e, NodeId t) {
    take_out(out, e, s, t);
    take_out(in, e, t, s);
  }
  void join(NodeId s, std::uint32_t e, NodeId t) {
    out[{e, s}].push_back(t);
    in[{e, t}].push_back(s);
  }
  bool reaches(std::uint32_t e, NodeId from, NodeId to) const {
    std::set<NodeId> seen;
    std::vector<NodeId> stack{from};
    while (!stack.empty()) {
      const NodeId n = stack.back();
      stack.pop_back();
      if (n == to) return true;
      if (!seen.insert(n).second) continue;
      for (const NodeId t : targets(e, n)) stack.push_back(t);
    }
    return false;
  }
  /// Returns what went.
  std::map<NodeId, ModelNode> remove(NodeId id) {
    std::map<NodeId, ModelNode> gone;
    std::vector<NodeId> going{id};
    while (!going.empty()) {
      const NodeId n = going.back();
      going.pop_back();
      if (!has(n)) continue;
      for (std::uint32_t e = 0; e < schema->edge_type_count(); ++e) {
        for (const NodeId s : sources(e, n)) {
          if (schema->edge(EdgeTypeId{e}).removes_sources) going.push_back(s);
          cut(s, e, n);
        }
        for (const NodeId t : targets(e, n)) cut(n, e, t);
      }
      gone.insert(*nodes.find(n));
      nodes.erase(n);
    }
    return gone;
  }
};

/// The first difference in words; empty where there is none. Order of targets counts where `ordered`.
inline std::string difference(const Model& m, const Snapshot& s, bool ordered = true) {
  if (m.nodes.size() != s.node_count())
    return "node count " + std::to_string(m.nodes.size()) + " against " + std::to_string(s.node_count());
  for (std::uint32_t t = 0; t < s.schema().type_count(); ++t) {
    std::set<NodeId> expected;
    for (const auto& [id, n] : m.nodes)
      if (s.schema().is_a(n.type, TypeId{t})) expected.insert(id);
    const auto list = s.nodes(TypeId{t});
    if (list.size() != expected.size() || std::set<NodeId>(list.begin(), list.end()) != expected)
      return "nodes of type " + s.schema().type(TypeId{t}).name;
    if (s.count(TypeId{t}) != expected.size()) return "count of " + s.schema().type(TypeId{t}).name;
  }
  for (const auto& [id, n] : m.nodes) {
    const std::string where = "node " + std::to_string(id.value) + " ";
    if (!s.contains(id) || s.type_of(id) != n.type) return where + "type";
    for (const auto& [a, v] : n.values) {
      const auto got = s.get(id, AttributeId{a});
      if (!got || !same_value(*got, v)) return where + s.schema().attribute(AttributeId{a}).spec.name;
    }
    const auto d = s.dynamic_attributes(id);
    if (!same_map(d, n.dynamic)) return where + "dynamic attributes";
    for (std::uint32_t e = 0; e < s.schema().edge_type_count(); ++e)
      for (const bool backwards : {false, true}) {
        const auto span = backwards ? s.sources(id, EdgeTypeId{e}) : s.targets(id, EdgeTypeId{e});
        std::vector<NodeId> got(span.begin(), span.end()),
            want = backwards ? m.sources(e, id) : m.targets(e, id);
        if (!ordered) {
          std::sort(got.begin(), got.end());
          std::sort(want.begin(), want.end());
        }
        if (got != want)
          return where + (backwards ? "sources of " : "targets of ") + s.schema().edge(EdgeTypeId{e}).name;
      }
  }
  return "";
}

/// Follows a world by its change sets alone.
inline void apply(Model& m, const ChangeSet& set) {
  for (const Change& c : set.changes) switch (c.kind) {
      case ChangeKind::created: {
        m.create(c.node, c.type);
        for (auto& [a, v] : m.nodes[c.node].values) v = *set.after.get(c.node, AttributeId{a});
        for (auto& [name, v] : set.after.dynamic_attributes(c.node)) m.nodes[c.node].dynamic[name] = v;
        break;
      }
      case ChangeKind::removed:
        m.nodes.erase(c.node);
        break;
      case ChangeKind::changed:
        if (c.dynamic.empty())
          m.nodes[c.node].values[c.attribute.value] = *set.after.get(c.node, c.attribute);
        else if (auto v = set.after.get(c.node, c.dynamic))
          m.nodes[c.node].dynamic[c.dynamic] = *v;
        else
          m.nodes[c.node].dynamic.erase(c.dynamic);
        break;
      case ChangeKind::connected:
        m.join(c.node, c.edge.value, c.other);
        break;
      case ChangeKind::disconnected:
        m.cut(c.node, c.edge.value, c.other);
        break;
    }
}

}  // namespace rigor::world::testing_model
