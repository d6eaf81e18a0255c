// The steps that change the stored world. They check nothing: what may be done is decided above. Each step is
// written to the log unless that is null.
#pragma once

#include <memory>
#include <unordered_set>
#include <vector>

#include "sim/world/graph/log.h"
#include "sim/world/graph/snapshot_state.h"

namespace rigor::world {

class Writer {
 public:
  explicit Writer(Memory& memory) : memory_(memory) {}

  World world;
  std::shared_ptr<const Layout> layout;
  Log* log = nullptr;

  /// After the schema has grown: existing tables get their new columns.
  void fit_layout();

  void create(NodeId node, std::uint32_t type);
  /// Precondition: it has no edges. A node that was made by mistake leaves no trace (`never_was`).
  void remove(NodeId node, bool never_was = false);
  /// `is_new`: made by this transaction, so that there is nothing to take back to.
  void set(NodeId node, Location l, std::uint16_t slot, const void* value, bool is_new);
  /// Empty: erases.
  void set_dynamic(NodeId node, std::uint32_t type, std::string_view name, const Value* value, bool is_new);
  static constexpr std::uint32_t kAtEnd = 0xFFFFFFFF;
  void connect(NodeId source, EdgeTypeId edge, NodeId target, std::uint32_t at_out = kAtEnd,
               std::uint32_t at_in = kAtEnd);
  /// Precondition: they are connected.
  void disconnect(NodeId source, EdgeTypeId edge, NodeId target);

  /// Before a snapshot: new nodes get into the index of places, each once, at the place that it has by now.
  void settle_places();

  /// Takes back step `i` of `from`.
  void invert(const Log& from, std::size_t i, bool never_was);

 private:
  /// Whether the index knows of the node: it was there when places were settled last.
  [[nodiscard]] bool is_settled(NodeId n) const {
    return n.value < settled_below_ && (unsettled_low_.empty() || !unsettled_low_.contains(n));
  }
  Table* my_table(std::uint32_t type);
  Tables* my_tables();
  Edges* my_edges();
  void insert(Array& lists, NodeId at, std::uint32_t index, NodeId value);
  void erase(Array& lists, NodeId at, std::uint32_t index);
  void part_of_changes(NodeId source, bool connects);
  Memory& memory_;
  std::vector<NodeId> unsettled_;
  std::unordered_set<NodeId> unsettled_low_;
  std::uint64_t settled_below_ = 1;
};

}  // namespace rigor::world
