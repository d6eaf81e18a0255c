#include <limits>

#include "sim/world/graph/check_value.h"
#include "sim/world/graph/snapshot_state.h"

namespace rigor::world {
namespace {

std::shared_ptr<Stored> leaf_of_defaults(ValueKind kind, const void* value) {
  const LeafOps& ops = leaf_ops(leaf_of(kind));
  auto* leaf = static_cast<Stored*>(::operator new(ops.leaf_bytes));
  ops.fill(leaf, value);
  return {leaf, [destroy = ops.destroy](Stored* l) {
            destroy(l);
            ::operator delete(l);
          }};
}

bool has_limits(const AttributeSpec& spec) {
  switch (kind_of(spec.default_value)) {
    case ValueKind::integer:
      return spec.min > -std::numeric_limits<double>::infinity() ||
             spec.max < std::numeric_limits<double>::infinity();
    case ValueKind::number:
    case ValueKind::vector3:
    case ValueKind::numbers:
      return true;
    case ValueKind::text:
      return !spec.choices.empty();
    default:
      return false;
  }
}

}  // namespace

Value value_from(ValueKind kind, const void* v) {
  switch (kind) {
    case ValueKind::flag:
      return *static_cast<const bool*>(v);
    case ValueKind::integer:
      return *static_cast<const std::int64_t*>(v);
    case ValueKind::number:
      return *static_cast<const double*>(v);
    case ValueKind::text:
      return *static_cast<const std::string*>(v);
    case ValueKind::vector3:
      return *static_cast<const Vector3*>(v);
    case ValueKind::pose:
      return *static_cast<const Pose*>(v);
    case ValueKind::motion:
      return *static_cast<const Motion*>(v);
    case ValueKind::numbers:
      return *static_cast<const Numbers*>(v);
    case ValueKind::blob:
      return *static_cast<const Blob*>(v);
  }
  return false;
}

std::shared_ptr<const Layout> Layout::make(const Schema& schema, const Layout* before) {
  auto l = std::make_shared<Layout>();
  l->schema = schema;
  const Schema& s = l->schema;
  for (std::uint32_t i = 0; i < s.attribute_count(); ++i) {
    const AttributeInfo& a = s.attribute(AttributeId{i});
    l->kinds.push_back(a.kind());
    l->limited.push_back(has_limits(a.spec));
    l->transient.push_back(a.spec.transient);
    l->defaults.push_back(address_of(a.spec.default_value));
    l->filled.push_back(before && i < before->filled.size() ? before->filled[i]
                                                            : leaf_of_defaults(a.kind(), l->defaults[i]));
  }
  if (const auto e = s.find_edge("part_of")) l->part_of = *e;
  for (std::uint32_t i = 0; i < s.edge_type_count(); ++i)
    l->ends.push_back({s.require_type(s.edge(EdgeTypeId{i}).from), s.require_type(s.edge(EdgeTypeId{i}).to)});
  for (std::uint32_t t = 0; t < s.type_count(); ++t) {
    TypeLayout type;
    if (before && t < before->types.size()) type.attributes = before->types[t].attributes;
    type.slot_of.assign(s.attribute_count(), kNone);
    for (std::size_t k = 0; k < type.attributes.size(); ++k)
      type.slot_of[type.attributes[k].value] = static_cast<std::uint16_t>(k);
    for (const AttributeId a : s.attributes(TypeId{t}))
      if (type.slot_of[a.value] == kNone) {
        type.slot_of[a.value] = static_cast<std::uint16_t>(type.attributes.size());
        type.attributes.push_back(a);
      }
    const auto slot_named = [&](std::string_view name, ValueKind kind) {
      const auto a = s.find_attribute(TypeId{t}, name);
      return a && l->kinds[a->value] == kind ? type.slot_of[a->value] : kNone;
    };
    type.pose = slot_named("pose", ValueKind::pose);
    type.motion = slot_named("motion", ValueKind::motion);
    type.moves = slot_named("moves", ValueKind::flag);
    type.position = slot_named("position", ValueKind::vector3);
    type.abstract = s.type(TypeId{t}).abstract;
    for (TypeId up{t};; up = s.base(up)) {
      const std::string& place = s.type(up).place_attribute;
      if (!place.empty()) {
        const AttributeId a = *s.find_attribute(TypeId{t}, place);
        type.place = type.slot_of[a.value];
        type.place_kind = l->kinds[a.value];
        break;
      }
      if (up.value == 0) break;
    }
    l->types.push_back(std::move(type));
  }
  return l;
}

bool Layout::place(const World& w, NodeId node, Location l, Vector3& p_world) const {
  const TypeLayout& type = types[l.type - 1];
  if (type.place == kNone) return false;
  const void* v = value(w, l, type.place);
  switch (type.place_kind) {
    case ValueKind::vector3:
      p_world = *static_cast<const Vector3*>(v);
      break;
    case ValueKind::pose:
      p_world = static_cast<const Pose*>(v)->translation();
      break;
    default:
      p_world = static_cast<const Motion*>(v)->T_parent_node.translation();
      break;
  }
  if (!p_world.allFinite()) return false;
  return type.place_kind == ValueKind::vector3 || w.neighbours(node, part_of.value, false).empty();
}

}  // namespace rigor::world
