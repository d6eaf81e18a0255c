// The tables of a world file, and how older ones become today's.
//
//   meta                 key, value: schema_version, generation (persists so far), next_node_id, layout
//   types                id, name, base, abstract, place_attribute, meaning, table_name
//   attributes           id, type, name, kind, unit, meaning, transient, min, max, nan_is_unknown,
//                        default_value
//   attribute_choices    attribute, position, word
//   edge_types           id, name, from_type, to_type, targets_per_source, sources_per_target, acyclic, …
//   nodes                id, type
//   Tree, Building, …    one for each type that has nodes of its own: id, and its attributes, inherited ones
//                        too, but for the transient (see value_codec.h)
//   edges                source, type, position (among the source's targets), target
//   dynamic_attributes   node, name, kind, value
//
//   SELECT species, count(*), max(height_m) FROM Tree GROUP BY species;
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sim/world/store/file_schema.h"
#include "sim/world/store/sqlite.h"

namespace rigor::world::store {

inline constexpr std::int64_t kFileVersion = 2;
inline constexpr std::int64_t kApplicationId = 0x52676F72;  // "Rgor"

/// In an empty file, within a transaction.
void create_tables(Sqlite& db);
/// Refuses what is no world of this or an older version. Reads alone.
void check_is_world(Sqlite& db);
/// Steps from the file's version to this one's, each within the transaction that is open.
void migrate(Sqlite& db);

/// The file's own numbers for what a schema knows by its own.
struct FileNumbers {
  struct Attribute {
    AttributeId id;
    ValueKind kind = ValueKind::flag;
    std::string name;
  };
  struct Type {
    std::int64_t number = 0;
    std::string table;                  ///< empty: abstract
    std::vector<Attribute> attributes;  ///< columns of the table, in their order
  };
  std::vector<Type> types;          ///< by TypeId
  std::vector<std::int64_t> edges;  ///< by EdgeTypeId
};

[[nodiscard]] FileSchema read_schema(Sqlite& db);
/// Writes what the file does not know yet: rows, tables, columns. Existing nodes get a new attribute's
/// default.
void write_schema(Sqlite& db, const Schema& schema);
/// Of a file that knows all of `schema`.
[[nodiscard]] FileNumbers read_numbers(Sqlite& db, const Schema& schema);

/// `"name"` or, where a kind has more than one column, `"name.x", "name.y", …`.
[[nodiscard]] std::vector<std::string> column_names(const std::string& attribute, ValueKind kind);

}  // namespace rigor::world::store
