// The world at one moment, read by any thread while the world goes on. Copying a snapshot costs a reference
// count; making one costs what changed since the last, never the size of the world.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rt-core/time.h"
#include "sim/world/graph/schema.h"
#include "sim/world/graph/value.h"

namespace rigor::world {

struct SnapshotState;  // sim/world/graph/snapshot_state.h, for the kernel alone

struct Box3 {
  Vector3 min = Vector3::Zero(), max = Vector3::Zero();
};

class Snapshot {
 public:
  Snapshot();  ///< an empty world
  explicit Snapshot(std::shared_ptr<const SnapshotState> state) : state_(std::move(state)) {}

  [[nodiscard]] const Schema& schema() const noexcept;
  /// Counts committed transactions, undo and redo among them.
  [[nodiscard]] std::uint64_t revision() const noexcept;

  // -------------------------------------------------------------- nodes and attributes
  [[nodiscard]] bool contains(NodeId node) const noexcept;
  /// Empty where there is no such node.
  [[nodiscard]] std::optional<TypeId> type_of(NodeId node) const noexcept;
  [[nodiscard]] bool is_a(NodeId node, TypeId type) const noexcept;
  [[nodiscard]] std::size_t node_count() const noexcept;
  /// Nodes of a type, its subtypes among them. Time grows with the number of subtypes alone.
  [[nodiscard]] std::size_t count(TypeId type) const noexcept;

  /// Value of an attribute, or null where there is no such node or its type lacks the attribute. Good until
  /// the snapshot (and its copies) end. Never allocates.
  template <class T>
  [[nodiscard]] const T* get(NodeId node, Attribute<T> attribute) const noexcept {
    return static_cast<const T*>(find(node, attribute.id));
  }
  /// As above, or the attribute's default.
  template <class T>
  [[nodiscard]] const T& get_or_default(NodeId node, Attribute<T> attribute) const {
    const T* v = get(node, attribute);
    return v ? *v : std::get<T>(schema().attribute(attribute.id).spec.default_value);
  }
  /// By name, own, inherited or dynamic; copies.
  [[nodiscard]] std::optional<Value> get(NodeId node, std::string_view name) const;
  [[nodiscard]] std::optional<Value> get(NodeId node, AttributeId attribute) const;
  /// Attributes that this node alone has, by name.
  [[nodiscard]] std::vector<std::pair<std::string, Value>> dynamic_attributes(NodeId node) const;

  /// Every node of a type and its subtypes: type by type in the order of definition, and within one in an
  /// order that depends on the history of transactions alone.
  void for_each(TypeId type, const std::function<void(NodeId)>& visit) const;
  [[nodiscard]] std::vector<NodeId> nodes(TypeId type) const;
  /// The fast scan: runs of neighbouring nodes with their values, in the order of for_each, handed to
  /// visit(std::span<const NodeId>, std::span<const T>).
  template <class T, class Visit>
  void scan(TypeId type, Attribute<T> attribute, Visit&& visit) const {
    scan_runs(type, attribute.id, [&](std::span<const NodeId> nodes, const void* values) {
      visit(nodes, std::span<const T>(static_cast<const T*>(values), nodes.size()));
    });
  }
  /// Nodes whose attribute has this value, in the order of for_each. By scan.
  [[nodiscard]] std::vector<NodeId> find_equal(TypeId type, AttributeId attribute, const Value& value) const;
  /// The first node with this `name` attribute.
  [[nodiscard]] std::optional<NodeId> find_named(TypeId type, std::string_view name) const;

  // -------------------------------------------------------------- edges
  /// Targets in the order in which they were connected. Good as long as the snapshot.
  [[nodiscard]] std::span<const NodeId> targets(NodeId source, EdgeTypeId edge) const noexcept;
  [[nodiscard]] std::span<const NodeId> sources(NodeId target, EdgeTypeId edge) const noexcept;
  /// The only target, or none.
  [[nodiscard]] NodeId target(NodeId source, EdgeTypeId edge) const noexcept;
  struct Step {
    EdgeTypeId edge;
    bool backwards = false;  ///< from target to source
  };
  /// Nodes at the end of a path of edges, each once, in the order of discovery.
  [[nodiscard]] std::vector<NodeId> follow(NodeId start, std::span<const Step> path) const;

  // -------------------------------------------------------------- space
  // Over nodes whose type has a place (TypeSpec::place_attribute). Results of one type and its subtypes,
  // nearest first (box: by node id). Nodes at places that are not finite are never found.
  [[nodiscard]] std::vector<NodeId> in_box(TypeId type, const Box3& box) const;
  [[nodiscard]] std::vector<NodeId> in_radius(TypeId type, const Vector3& centre, double radius_m) const;
  [[nodiscard]] std::vector<NodeId> nearest(TypeId type, const Vector3& centre, std::size_t k) const;

  // -------------------------------------------------------------- poses
  /// Pose of a node in the world at an instant, up the `part_of` edges. A node's own pose is its `motion`
  /// where that was set, else its `pose`, else its `position`, else identity.
  [[nodiscard]] Pose T_world_node(NodeId node, BenchTime t) const;

  [[nodiscard]] const SnapshotState& state() const noexcept { return *state_; }

 private:
  [[nodiscard]] const void* find(NodeId node, AttributeId attribute) const noexcept;
  void scan_runs(TypeId type, AttributeId attribute,
                 const std::function<void(std::span<const NodeId>, const void*)>& visit) const;
  std::shared_ptr<const SnapshotState> state_;
};

}  // namespace rigor::world
