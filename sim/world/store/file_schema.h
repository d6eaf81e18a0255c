// The types of a file against those of a database.
#pragma once

#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/world/graph/database.h"

namespace rigor::world::store {

/// What a file says of its types: bases before what inherits from them, each with its own attributes alone.
struct FileSchema {
  std::vector<TypeSpec> types;
  std::vector<EdgeSpec> edges;
};

/// The part of a schema that a world needs: all of it, or the types with nodes and the edges in use, with
/// the types that these name.
[[nodiscard]] FileSchema whole_schema(const Schema& schema);
[[nodiscard]] FileSchema used_schema(const Snapshot& world);

/// Defines what the database lacks; a type that both know must have the same base, and each attribute the
/// same kind and unit. Where something differs the database stays as it is. bad_input.
[[nodiscard]] Status merge_schema(const FileSchema& file, Database& db, const std::string& where);

}  // namespace rigor::world::store
