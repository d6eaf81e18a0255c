// What kinds of nodes and edges a world can have: types with single inheritance, typed attributes with units,
// typed edges with cardinality. Types come from plugins; the kernel itself knows `Object` alone, the root.
//
// A schema only grows: what is defined stays until the database ends. Handles (Attribute<T>) are resolved
// once, by name, and are then good for every node of the type and its subtypes.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sim/world/graph/value.h"

namespace rigor::world {

struct TypeId {
  std::uint32_t value = 0;  ///< 0: Object
  auto operator<=>(const TypeId&) const = default;
};
struct AttributeId {
  std::uint32_t value = std::numeric_limits<std::uint32_t>::max();
  auto operator<=>(const AttributeId&) const = default;
};
struct EdgeTypeId {
  std::uint32_t value = std::numeric_limits<std::uint32_t>::max();
  auto operator<=>(const EdgeTypeId&) const = default;
};

template <class T>
inline constexpr ValueKind kKindOf{};  // of the alternatives of Value alone
template <>
inline constexpr ValueKind kKindOf<bool> = ValueKind::flag;
template <>
inline constexpr ValueKind kKindOf<std::int64_t> = ValueKind::integer;
template <>
inline constexpr ValueKind kKindOf<double> = ValueKind::number;
template <>
inline constexpr ValueKind kKindOf<std::string> = ValueKind::text;
template <>
inline constexpr ValueKind kKindOf<Vector3> = ValueKind::vector3;
template <>
inline constexpr ValueKind kKindOf<Pose> = ValueKind::pose;
template <>
inline constexpr ValueKind kKindOf<Motion> = ValueKind::motion;
template <>
inline constexpr ValueKind kKindOf<Numbers> = ValueKind::numbers;
template <>
inline constexpr ValueKind kKindOf<Blob> = ValueKind::blob;

/// An AttributeId that knows what it holds. Made by Schema::attribute, which checks.
template <class T>
struct Attribute {
  AttributeId id;
};

struct AttributeSpec {
  std::string name;          ///< lower_case_with_unit, e.g. `diameter_m`
  Value default_value;       ///< gives the kind too
  std::string unit = "";     ///< SI or `deg`; empty: none
  std::string meaning = "";  ///< one sentence
  bool transient = false;    ///< simulation state: no undo, no disk
  /// For number and integer (every component of vector3 and numbers): what a value must lie in; NaN is
  /// refused unless `nan_is_unknown`.
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
  bool nan_is_unknown = false;
  std::vector<std::string> choices = {};  ///< for text: the words that are allowed; empty: any
};

struct TypeSpec {
  std::string name;             ///< UpperCamelCase
  std::string base = "Object";  ///< must exist
  bool abstract = false;        ///< no node is of this type itself
  std::string meaning = "";
  std::vector<AttributeSpec> attributes = {};
  /// Name of the vector3, pose or motion attribute, own or inherited, that places a node in space; empty: as
  /// the base. Nodes with a place are found by box, radius and nearness (poses count in the parent's frame:
  /// only nodes without a `part_of` parent are indexed).
  std::string place_attribute = "";
};

/// How many edges of a type a node may have on one end.
enum class Cardinality : std::uint8_t { one, many };

struct EdgeSpec {
  std::string name;  ///< lower_case, reads as a verb: from `made_of` to
  std::string from = "Object", to = "Object";
  Cardinality targets_per_source = Cardinality::many;
  Cardinality sources_per_target = Cardinality::many;
  bool acyclic = false;          ///< refuse a connection that closes a ring
  bool removes_sources = false;  ///< removing the target removes its sources (part_of: a tree of ownership)
  std::string meaning = "";
};

struct AttributeInfo {
  AttributeId id;
  TypeId owner;  ///< the type that defines it
  AttributeSpec spec;
  [[nodiscard]] ValueKind kind() const noexcept { return kind_of(spec.default_value); }
};

/// The introspection of a world. A Schema that a snapshot gives is that of its moment and never changes.
class Schema {
 public:
  Schema();
  [[nodiscard]] std::size_t type_count() const noexcept { return types_.size(); }
  [[nodiscard]] std::optional<TypeId> find_type(std::string_view name) const;
  [[nodiscard]] const TypeSpec& type(TypeId t) const { return types_[t.value].spec; }
  [[nodiscard]] TypeId base(TypeId t) const { return types_[t.value].base; }
  /// True for the type itself too. Constant time.
  [[nodiscard]] bool is_a(TypeId t, TypeId ancestor) const noexcept {
    return t.value < types_.size() && ancestor.value < types_[t.value].is.size() &&
           types_[t.value].is[ancestor.value];
  }
  /// The type and all that inherit from it, in the order of their definition.
  [[nodiscard]] const std::vector<TypeId>& with_subtypes(TypeId t) const { return types_[t.value].subtypes; }
  /// Attributes of a type, inherited ones first, in the order of their definition.
  [[nodiscard]] const std::vector<AttributeId>& attributes(TypeId t) const {
    return types_[t.value].attributes;
  }

  [[nodiscard]] std::size_t attribute_count() const noexcept { return attributes_.size(); }
  [[nodiscard]] const AttributeInfo& attribute(AttributeId a) const { return attributes_[a.value]; }
  /// Own or inherited.
  [[nodiscard]] std::optional<AttributeId> find_attribute(TypeId t, std::string_view name) const;
  /// Typed handle. bad_input: no such type or attribute, or another kind; the message offers the nearest
  /// name.
  template <class T>
  [[nodiscard]] Result<Attribute<T>> attribute(std::string_view type, std::string_view name) const {
    auto a = resolve(type, name, kKindOf<T>);
    if (!a) return tl::unexpected(a.error());
    return Attribute<T>{*a};
  }
  /// As above for names that the code itself has defined. Throws std::logic_error.
  template <class T>
  [[nodiscard]] Attribute<T> require(std::string_view type, std::string_view name) const {
    return Attribute<T>{require_id(type, name, kKindOf<T>)};
  }
  [[nodiscard]] TypeId require_type(std::string_view name) const;
  [[nodiscard]] EdgeTypeId require_edge(std::string_view name) const;

  [[nodiscard]] std::size_t edge_type_count() const noexcept { return edges_.size(); }
  [[nodiscard]] std::optional<EdgeTypeId> find_edge(std::string_view name) const;
  [[nodiscard]] const EdgeSpec& edge(EdgeTypeId e) const { return edges_[e.value]; }

  /// For the database alone; users define through it. bad_input: a name twice, an unknown base, a bad name,
  /// a default outside its own limits, an attribute that hides an inherited one.
  Result<TypeId> define(const TypeSpec& spec);
  Result<EdgeTypeId> define(const EdgeSpec& spec);
  Result<AttributeId> add_attribute(TypeId type, const AttributeSpec& spec);

 private:
  struct Type {
    TypeSpec spec;
    TypeId base;
    std::vector<bool> is;
    std::vector<TypeId> subtypes;
    std::vector<AttributeId> attributes;
  };
  [[nodiscard]] Result<AttributeId> resolve(std::string_view type, std::string_view name,
                                            ValueKind kind) const;
  [[nodiscard]] AttributeId require_id(std::string_view type, std::string_view name, ValueKind kind) const;
  std::vector<Type> types_;
  std::vector<AttributeInfo> attributes_;
  std::vector<EdgeSpec> edges_;
};

}  // namespace rigor::world
