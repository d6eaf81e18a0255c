#include "sim/world/graph/net_changes.h"

#include <algorithm>
#include <unordered_map>

#include "sim/world/graph/same.h"

namespace rigor::world {
namespace {

struct Key {
  std::uint64_t node, other;
  std::uint32_t what;
  std::uint8_t kind;  // 0 node, 1 attribute, 2 edge
  bool operator==(const Key&) const = default;
};

std::uint64_t mix(std::uint64_t h, std::uint64_t v) {
  h ^= v;
  h *= 0x9E3779B97F4A7C15ULL;
  return h ^ (h >> 29);
}

/// Open addressing; says whether a key comes for the first time.
class FirstTouch {
 public:
  explicit FirstTouch(std::size_t n) {
    std::size_t room = 16;
    while (room < 2 * n) room *= 2;
    slots_.assign(room, {});
  }
  bool operator()(const Key& k) {
    std::size_t i = mix(mix(k.node, k.other), std::uint64_t{k.what} << 8 | k.kind) & (slots_.size() - 1);
    while (slots_[i].kind != kEmpty) {
      if (slots_[i] == k) return false;
      i = (i + 1) & (slots_.size() - 1);
    }
    slots_[i] = k;
    return true;
  }

 private:
  static constexpr std::uint8_t kEmpty = 0xFF;
  struct Slot : Key {
    Slot() : Key{0, 0, 0, kEmpty} {}
    Slot(const Key& k) : Key(k) {}
  };
  std::vector<Slot> slots_;
};

bool connected_now(const World& w, NodeId source, std::uint32_t edge, NodeId target) {
  const auto out = w.neighbours(source, edge, false);
  const auto in = w.neighbours(target, edge, true);
  return out.size() <= in.size() ? std::find(out.begin(), out.end(), target) != out.end()
                                 : std::find(in.begin(), in.end(), source) != in.end();
}

}  // namespace

std::vector<Change> net_changes(const World& now, const Layout& layout, const Log& log, std::size_t first) {
  std::vector<Change> changes;
  const std::size_t n = log.ops.size() - first;
  if (n == 0) return changes;
  changes.reserve(n);

  // Of nodes that were made or removed: whether they were there before.
  std::unordered_map<NodeId, bool> was;
  for (std::size_t i = first; i < log.ops.size(); ++i) {
    const Op& op = log.ops[i];
    if (op.kind == OpKind::create || op.kind == OpKind::remove)
      was.emplace(op.node, op.kind == OpKind::remove);
  }
  const auto was_there = [&](NodeId node) {
    if (was.empty()) return true;
    const auto it = was.find(node);
    return it == was.end() || it->second;
  };

  FirstTouch is_first(n > 1 ? n : 0);
  const auto seen = [&](const Key& k) { return n > 1 && !is_first(k); };
  std::unordered_map<NodeId, std::vector<std::string>> seen_dynamic;
  for (std::size_t i = first; i < log.ops.size(); ++i) {
    const Op& op = log.ops[i];
    Change c{.node = op.node, .type = TypeId{op.type}};
    switch (op.kind) {
      case OpKind::create:
      case OpKind::remove: {
        if (seen({op.node.value, 0, 0, 0})) break;
        const bool is = now.location(op.node).is_there();
        if (was_there(op.node) == is) break;
        c.kind = is ? ChangeKind::created : ChangeKind::removed;
        changes.push_back(std::move(c));
        break;
      }
      case OpKind::set: {
        if (seen({op.node.value, 0, op.what, 1})) break;
        const Location l = now.location(op.node);
        if (!l.is_there() || !was_there(op.node)) break;
        const void* is = layout.value(now, l, layout.slot(op.type, AttributeId{op.what}));
        if (leaf_ops(leaf_of(op.value_kind)).same(is, log.kept(op.value_kind, op.other))) break;
        c.attribute = AttributeId{op.what};
        changes.push_back(std::move(c));
        break;
      }
      case OpKind::set_dynamic: {
        const OldDynamic& old = log.dynamics[op.other];
        auto& names = seen_dynamic[op.node];
        if (std::find(names.begin(), names.end(), old.name) != names.end()) break;
        names.push_back(old.name);
        if (!now.location(op.node).is_there() || !was_there(op.node)) break;
        const DynamicMap* map = now.dynamic_map(op.node);
        const Value* is = nullptr;
        if (map)
          if (const auto it = map->values.find(old.name); it != map->values.end()) is = &it->second;
        if ((!is && !old.value) || (is && old.value && same_value(*is, *old.value))) break;
        c.dynamic = old.name;
        changes.push_back(std::move(c));
        break;
      }
      case OpKind::connect:
      case OpKind::disconnect: {
        if (seen({op.node.value, op.other, op.what, 2})) break;
        const bool is = connected_now(now, op.node, op.what, NodeId{op.other});
        if (is == (op.kind == OpKind::disconnect)) break;
        c.kind = is ? ChangeKind::connected : ChangeKind::disconnected;
        c.edge = EdgeTypeId{op.what};
        c.other = NodeId{op.other};
        changes.push_back(std::move(c));
        break;
      }
    }
  }
  return changes;
}

}  // namespace rigor::world
