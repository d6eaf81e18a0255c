// What a transaction did, step by step: enough to take it back, and to say in the end what its effects were.
#pragma once

#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "sim/world/graph/schema.h"
#include "sim/world/graph/storage.h"

namespace rigor::world {

enum class OpKind : std::uint8_t { create, remove, set, set_dynamic, connect, disconnect };

struct Op {
  OpKind kind;
  ValueKind value_kind = ValueKind::flag;  ///< of set
  std::uint32_t what = 0;                  ///< attribute or edge type
  std::uint32_t type = 0;                  ///< of the node
  NodeId node;
  std::uint64_t other = 0;   ///< of edges: the target; else where in the log the old value lies
  std::uint32_t at_out = 0;  ///< of edges: place among the source's targets
  std::uint32_t at_in = 0;   ///< … and among the target's sources
};

struct OldDynamic {
  std::string name;
  std::optional<Value> value;
};
struct OldNode {
  std::vector<std::pair<AttributeId, Value>> values;  ///< those that are not defaults
  std::map<std::string, Value, std::less<>> dynamic;
};

struct Log {
  std::vector<Op> ops;
  std::vector<OldDynamic> dynamics;
  std::vector<OldNode> nodes;

  /// Where the copy of a value came to lie.
  std::uint64_t keep(ValueKind kind, const void* value);
  [[nodiscard]] const void* kept(ValueKind kind, std::uint64_t at) const;
  [[nodiscard]] bool empty() const { return ops.empty(); }
  void clear();
  [[nodiscard]] std::size_t bytes() const;

 private:
  template <class T>
  struct Box {
    T v;
  };
  std::tuple<std::vector<Box<bool>>, std::vector<Box<std::int64_t>>, std::vector<Box<double>>,
             std::vector<Box<std::string>>, std::vector<Box<Vector3>>, std::vector<Box<Pose>>,
             std::vector<Box<Motion>>, std::vector<Box<Numbers>>, std::vector<Box<Blob>>>
      values_;
  template <class F>
  static auto with_kind(ValueKind kind, const F& f);
};

}  // namespace rigor::world
