// What a snapshot holds: the roots of the world of its moment, the schema of that moment, and the memory that
// both lie in. For the kernel alone.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "sim/world/graph/schema.h"
#include "sim/world/graph/snapshot.h"
#include "sim/world/graph/storage.h"

namespace rigor::world {

/// How the attributes of each type lie in the columns of its table. Made anew whenever the schema grows; a
/// column keeps its number.
struct Layout {
  static constexpr std::uint16_t kNone = 0xFFFF;
  struct TypeLayout {
    std::vector<std::uint16_t> slot_of;   ///< by attribute, over the whole schema
    std::vector<AttributeId> attributes;  ///< by slot
    std::uint16_t pose = kNone, motion = kNone, moves = kNone, position = kNone;
    std::uint16_t place = kNone;
    ValueKind place_kind = ValueKind::vector3;
    bool abstract = false;
  };
  Schema schema;
  std::vector<TypeLayout> types;
  std::vector<ValueKind> kinds;                 ///< by attribute
  std::vector<std::uint8_t> limited;            ///< by attribute: a value has to be looked at
  std::vector<std::uint8_t> transient;          ///< by attribute
  std::vector<const void*> defaults;            ///< by attribute: its value
  std::vector<std::shared_ptr<Stored>> filled;  ///< by attribute: a leaf of defaults
  EdgeTypeId part_of;
  struct Ends {
    TypeId from, to;
  };
  std::vector<Ends> ends;  ///< by edge type

  [[nodiscard]] static std::shared_ptr<const Layout> make(const Schema& schema, const Layout* before);

  [[nodiscard]] std::uint16_t slot(std::uint32_t type, AttributeId a) const {
    const auto& s = types[type].slot_of;
    return a.value < s.size() ? s[a.value] : kNone;
  }
  /// Null where the node is not there or has no such attribute.
  [[nodiscard]] const void* find(const World& w, NodeId node, AttributeId a) const {
    const Location l = w.location(node);
    if (!l.is_there()) return nullptr;
    const std::uint16_t s = slot(l.type - 1, a);
    if (s == kNone) return nullptr;
    const void* v = rigor::world::find(w.tables->of[l.type - 1]->column[s], leaf_of(kinds[a.value]), l.row);
    return v ? v : defaults[a.value];
  }
  /// Of a slot, of a node that is there.
  [[nodiscard]] const void* value(const World& w, Location l, std::uint16_t s) const {
    const AttributeId a = types[l.type - 1].attributes[s];
    const void* v = rigor::world::find(w.tables->of[l.type - 1]->column[s], leaf_of(kinds[a.value]), l.row);
    return v ? v : defaults[a.value];
  }
  /// Where the node stands for queries of space; false: nowhere.
  [[nodiscard]] bool place(const World& w, NodeId node, Location l, Vector3& p_world) const;
};

[[nodiscard]] Value value_from(ValueKind kind, const void* v);

struct SnapshotState {
  World world;
  std::shared_ptr<const Layout> layout;
  std::shared_ptr<Memory> memory;
  std::uint64_t version = 0;
  ~SnapshotState() {
    if (memory) memory->release(version);
  }
};

}  // namespace rigor::world
