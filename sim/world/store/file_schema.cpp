#include "sim/world/store/file_schema.h"

#include <algorithm>
#include <set>

namespace rigor::world::store {
namespace {

TypeSpec own_spec(const Schema& schema, TypeId t) {
  TypeSpec spec = schema.type(t);
  spec.attributes.clear();
  for (const auto a : schema.attributes(t))
    if (schema.attribute(a).owner == t) spec.attributes.push_back(schema.attribute(a).spec);
  return spec;
}

constexpr const char* kAdvice =
    "; the file was written with other plugins or another version of them: load those, or import the world "
    "anew";

Status check_attribute(const AttributeInfo& here, const AttributeSpec& file, const std::string& name,
                       const std::string& where) {
  if (here.kind() != kind_of(file.default_value))
    return fail(ErrorCode::bad_input, where,
                name + ": expected " + std::string(name_of(here.kind())) + ", got " +
                    std::string(name_of(kind_of(file.default_value))) + kAdvice);
  if (here.spec.unit != file.unit)
    return fail(ErrorCode::bad_input, where,
                name + ": expected the unit '" + here.spec.unit + "', got '" + file.unit + "'" + kAdvice);
  return {};
}

Status differs(const std::string& where, const std::string& what, const std::string& expected,
               const std::string& got) {
  return fail(ErrorCode::bad_input, where, what + ": expected " + expected + ", got " + got + kAdvice);
}

std::string describe(const EdgeSpec& e) {
  const auto count = [](Cardinality c) { return c == Cardinality::one ? "one" : "many"; };
  return e.from + " (" + count(e.sources_per_target) + ") to " + e.to + " (" + count(e.targets_per_source) +
         ")" + (e.acyclic ? ", without rings" : "") + (e.removes_sources ? ", removes its sources" : "");
}

/// Over a Schema (to try) and a Database (to do).
template <class Target>
Status merge_into(const FileSchema& file, Target& target, const Schema& schema, const std::string& where) {
  const auto in_file = [&](const Error& e) { return fail(ErrorCode::bad_input, where, e.message); };
  for (const auto& type : file.types) {
    const auto here = schema.find_type(type.name);
    if (!here) {
      auto made = target.define(type);
      if (!made) return in_file(made.error());
      continue;
    }
    const auto& known = schema.type(*here);
    if (*here != TypeId{} && known.base != type.base)
      return differs(where, type.name, "the base " + known.base, type.base);
    if (known.abstract != type.abstract)
      return differs(where, type.name, known.abstract ? "an abstract type" : "a type of nodes",
                     type.abstract ? "an abstract type" : "a type of nodes");
    for (const auto& attribute : type.attributes) {
      const auto name = type.name + "." + attribute.name;
      if (const auto a = schema.find_attribute(*here, attribute.name)) {
        if (auto s = check_attribute(schema.attribute(*a), attribute, name, where); !s) return s;
      } else if (auto added = target.add_attribute(*here, attribute); !added) {
        return in_file(added.error());
      }
    }
  }
  for (const auto& edge : file.edges) {
    const auto here = schema.find_edge(edge.name);
    if (!here) {
      auto made = target.define(edge);
      if (!made) return in_file(made.error());
    } else if (describe(schema.edge(*here)) != describe(edge)) {
      return differs(where, edge.name, describe(schema.edge(*here)), describe(edge));
    }
  }
  return {};
}

}  // namespace

FileSchema whole_schema(const Schema& schema) {
  FileSchema out;
  for (std::uint32_t t = 0; t < schema.type_count(); ++t) out.types.push_back(own_spec(schema, TypeId{t}));
  for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e)
    out.edges.push_back(schema.edge(EdgeTypeId{e}));
  return out;
}

FileSchema used_schema(const Snapshot& world) {
  const auto& schema = world.schema();
  std::set<TypeId> used = {TypeId{}};
  const auto use = [&](TypeId t) {
    for (; used.insert(t).second; t = schema.base(t)) {
    }
  };
  std::set<EdgeTypeId> edges;
  world.for_each(TypeId{}, [&](NodeId node) {
    use(*world.type_of(node));
    for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e)
      if (!world.targets(node, EdgeTypeId{e}).empty()) edges.insert(EdgeTypeId{e});
  });
  FileSchema out;
  for (const auto e : edges) {
    out.edges.push_back(schema.edge(e));
    use(schema.require_type(schema.edge(e).from));
    use(schema.require_type(schema.edge(e).to));
  }
  for (const auto t : used) out.types.push_back(own_spec(schema, t));
  return out;
}

Status merge_schema(const FileSchema& file, Database& db, const std::string& where) {
  Schema trial = db.schema();
  if (auto s = merge_into(file, trial, trial, where); !s) return s;
  return merge_into(file, db, db.schema(), where);
}

}  // namespace rigor::world::store
