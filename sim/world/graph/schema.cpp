#include "sim/world/graph/schema.h"

#include <algorithm>
#include <stdexcept>

#include "sensor-hal/config/yaml.h"
#include "sim/world/graph/check_value.h"

namespace rigor::world {
namespace {

bool is_lower(char c) { return c >= 'a' && c <= 'z'; }
bool is_upper(char c) { return c >= 'A' && c <= 'Z'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

bool is_lower_name(std::string_view n) {
  return !n.empty() && is_lower(n[0]) &&
         std::all_of(n.begin(), n.end(), [](char c) { return is_lower(c) || is_digit(c) || c == '_'; });
}
bool is_type_name(std::string_view n) {
  return !n.empty() && is_upper(n[0]) &&
         std::all_of(n.begin(), n.end(), [](char c) { return is_lower(c) || is_upper(c) || is_digit(c); });
}

std::string near(std::string_view word, const std::vector<std::string>& candidates) {
  const std::string n = nearest(word, candidates);
  return n.empty() ? "" : "; did you mean '" + n + "'?";
}

tl::unexpected<Error> bad(std::string where, std::string message) {
  return fail(ErrorCode::bad_input, std::move(where), std::move(message));
}

}  // namespace

Schema::Schema() {
  Type object;
  object.spec.name = "Object";
  object.spec.base = "";
  object.spec.meaning = "The root of all types.";
  object.is = {true};
  object.subtypes = {TypeId{0}};
  types_.push_back(std::move(object));
}

std::optional<TypeId> Schema::find_type(std::string_view name) const {
  for (std::uint32_t i = 0; i < types_.size(); ++i)
    if (types_[i].spec.name == name) return TypeId{i};
  return std::nullopt;
}

std::optional<EdgeTypeId> Schema::find_edge(std::string_view name) const {
  for (std::uint32_t i = 0; i < edges_.size(); ++i)
    if (edges_[i].name == name) return EdgeTypeId{i};
  return std::nullopt;
}

std::optional<AttributeId> Schema::find_attribute(TypeId t, std::string_view name) const {
  if (t.value >= types_.size()) return std::nullopt;
  for (const AttributeId a : types_[t.value].attributes)
    if (attributes_[a.value].spec.name == name) return a;
  return std::nullopt;
}

Result<AttributeId> Schema::resolve(std::string_view type, std::string_view name, ValueKind kind) const {
  const auto t = find_type(type);
  if (!t) {
    std::vector<std::string> names;
    for (const auto& x : types_) names.push_back(x.spec.name);
    return bad(std::string(type), "no such node type" + near(type, names));
  }
  const auto a = find_attribute(*t, name);
  const std::string where = std::string(type) + "." + std::string(name);
  if (!a) {
    std::vector<std::string> names;
    for (const AttributeId x : types_[t->value].attributes) names.push_back(attributes_[x.value].spec.name);
    return bad(where, "no such attribute" + near(name, names));
  }
  const ValueKind is = attributes_[a->value].kind();
  if (is != kind)
    return bad(where, "expected an attribute of kind " + std::string(name_of(kind)) + ", it is of kind " +
                          std::string(name_of(is)));
  return *a;
}

AttributeId Schema::require_id(std::string_view type, std::string_view name, ValueKind kind) const {
  auto a = resolve(type, name, kind);
  if (!a) throw std::logic_error(a.error().text());
  return *a;
}

TypeId Schema::require_type(std::string_view name) const {
  if (auto t = find_type(name)) return *t;
  throw std::logic_error(std::string(name) + ": no such node type");
}

EdgeTypeId Schema::require_edge(std::string_view name) const {
  if (auto e = find_edge(name)) return *e;
  throw std::logic_error(std::string(name) + ": no such edge type");
}

Result<TypeId> Schema::define(const TypeSpec& spec) {
  if (!is_type_name(spec.name))
    return bad(spec.name, "a node type is named in UpperCamelCase, with letters and digits alone");
  if (find_type(spec.name)) return bad(spec.name, "a node type of this name is defined already");
  const auto base = find_type(spec.base);
  if (!base) {
    std::vector<std::string> names;
    for (const auto& x : types_) names.push_back(x.spec.name);
    return bad(spec.name, "its base '" + spec.base + "' is not defined" + near(spec.base, names));
  }
  for (std::size_t i = 0; i < spec.attributes.size(); ++i) {
    const AttributeSpec& a = spec.attributes[i];
    const std::string where = spec.name + "." + a.name;
    if (!is_lower_name(a.name))
      return bad(where, "an attribute is named with lower-case letters, digits and _, a letter first");
    if (find_attribute(*base, a.name)) return bad(where, "hides an inherited attribute");
    for (std::size_t k = 0; k < i; ++k)
      if (spec.attributes[k].name == a.name) return bad(where, "the attribute stands there twice");
    if (auto wrong = check_value(a, address_of(a.default_value))) return bad(where, "its default: " + *wrong);
  }
  if (!spec.place_attribute.empty()) {
    std::optional<ValueKind> kind;
    if (auto a = find_attribute(*base, spec.place_attribute)) kind = attributes_[a->value].kind();
    for (const auto& a : spec.attributes)
      if (a.name == spec.place_attribute) kind = kind_of(a.default_value);
    if (!kind) return bad(spec.name, "its place attribute '" + spec.place_attribute + "' is not defined");
    if (*kind != ValueKind::vector3 && *kind != ValueKind::pose && *kind != ValueKind::motion)
      return bad(spec.name, "its place attribute '" + spec.place_attribute +
                                "' must be a vector3, pose or motion, it is a " +
                                std::string(name_of(*kind)));
  }

  const TypeId id{static_cast<std::uint32_t>(types_.size())};
  Type t;
  t.spec = spec;
  t.spec.attributes.clear();
  t.base = *base;
  t.is = types_[base->value].is;
  t.is.resize(id.value + 1, false);
  t.is[id.value] = true;
  t.subtypes = {id};
  t.attributes = types_[base->value].attributes;
  types_.push_back(std::move(t));
  for (TypeId up = *base;; up = types_[up.value].base) {
    types_[up.value].subtypes.push_back(id);
    if (up.value == 0) break;
  }
  for (const auto& a : spec.attributes)
    if (auto added = add_attribute(id, a); !added) return tl::unexpected(added.error());
  return id;
}

Result<AttributeId> Schema::add_attribute(TypeId type, const AttributeSpec& spec) {
  if (type.value >= types_.size())
    return bad(spec.name, "no node type has the number " + std::to_string(type.value));
  const std::string where = types_[type.value].spec.name + "." + spec.name;
  if (!is_lower_name(spec.name))
    return bad(where, "an attribute is named with lower-case letters, digits and _, a letter first");
  for (const TypeId t : types_[type.value].subtypes)
    if (find_attribute(t, spec.name))
      return bad(where, t == type ? "the attribute is there already"
                                  : "subtype " + types_[t.value].spec.name + " has one of this name already");
  if (auto wrong = check_value(spec, address_of(spec.default_value)))
    return bad(where, "its default: " + *wrong);

  const AttributeId id{static_cast<std::uint32_t>(attributes_.size())};
  attributes_.push_back({id, type, spec});
  types_[type.value].spec.attributes.push_back(spec);
  // Inherited ones first: after all that the base gives, so lists of subtypes are made anew from the top.
  std::vector<std::vector<AttributeId>> own(types_.size());
  for (const auto& a : attributes_) own[a.owner.value].push_back(a.id);
  for (std::uint32_t t = 0; t < types_.size(); ++t) {
    types_[t].attributes = t == 0 ? std::vector<AttributeId>{} : types_[types_[t].base.value].attributes;
    types_[t].attributes.insert(types_[t].attributes.end(), own[t].begin(), own[t].end());
  }
  return id;
}

Result<EdgeTypeId> Schema::define(const EdgeSpec& spec) {
  if (!is_lower_name(spec.name))
    return bad(spec.name, "an edge type is named with lower-case letters, digits and _, a letter first");
  if (find_edge(spec.name)) return bad(spec.name, "an edge type of this name is defined already");
  for (const auto& end : {spec.from, spec.to})
    if (!find_type(end)) {
      std::vector<std::string> names;
      for (const auto& x : types_) names.push_back(x.spec.name);
      return bad(spec.name, "its end '" + end + "' is not a node type" + near(end, names));
    }
  edges_.push_back(spec);
  return EdgeTypeId{static_cast<std::uint32_t>(edges_.size() - 1)};
}

}  // namespace rigor::world
