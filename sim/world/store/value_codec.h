// How values lie in a world file: as columns of their node's table, and as one cell (defaults, dynamic
// attributes). Also base64, for YAML.
//
//   flag, integer   INTEGER            number   REAL; NULL is NaN, a BLOB of 8 bytes -0.0
//   text            TEXT               numbers  BLOB: little-endian float64, one after the other
//   vector3         NAME.x .y .z       blob     BLOB
//   pose            NAME.r11 .r12 .r13 .x .r21 .r22 .r23 .y .r31 .r32 .r33 .z: the rows of [R t]
//   motion          NAME.t_ref_ns, the twelve of its pose, .vx .vy .vz .wx .wy .wz
//
// In one cell vector3, pose and motion are BLOBs of the same reals in the same order (t_ref as int64).
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sim/world/graph/value.h"
#include "sim/world/store/sqlite.h"

namespace rigor::world::store {

struct Column {
  std::string_view suffix;    ///< behind the attribute's name
  std::string_view declared;  ///< its type in SQL
};
[[nodiscard]] std::span<const Column> columns_of(ValueKind kind);

/// Binds as many parameters as the kind has columns. The value must stay until the statement has run.
void bind_columns(Statement& statement, int at, const Value& value);
/// Empty where a column holds something else.
[[nodiscard]] std::optional<Value> read_columns(const Statement& statement, int at, ValueKind kind);

/// One cell. `scratch` keeps the bytes until the statement has run.
void bind_cell(Statement& statement, int at, const Value& value, std::vector<double>& scratch);
[[nodiscard]] std::optional<Value> read_cell(const Statement& statement, int at, ValueKind kind);

[[nodiscard]] std::optional<ValueKind> kind_named(std::string_view name);
/// The value's reals in the order of its columns: vector3 3, pose 12, motion 18 (without t_ref).
[[nodiscard]] std::vector<double> reals_of(const Value& value);
[[nodiscard]] Vector3 vector3_of(std::span<const double> three);
[[nodiscard]] Pose pose_of(std::span<const double> twelve);
[[nodiscard]] Motion motion_of(BenchTime t_ref, std::span<const double> eighteen);

[[nodiscard]] std::string base64(std::span<const std::byte> bytes);
/// Empty where the text is no base64 (RFC 4648, padded).
[[nodiscard]] std::optional<std::vector<std::byte>> from_base64(std::string_view text);

}  // namespace rigor::world::store
