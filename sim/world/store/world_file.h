// A world on disk: one SQLite file that knows its schema version and can be read with the sqlite3 shell.
//
// Committing to memory and persisting are two things: `persist` writes what has changed since the last time,
// and what it has acknowledged survives kill -9 and power loss.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "rt-core/result.h"
#include "sim/world/graph/database.h"

namespace rigor::world {

class WorldFile {
 public:
  enum class Access : std::uint8_t { read_write, read_only };

  /// A new file for this database, a world without nodes; the first persist() writes all of it. The database
  /// must outlive the file. Errors: not_writable, bad_input (it exists), disk_full.
  [[nodiscard]] static Result<std::unique_ptr<WorldFile>> create(const std::filesystem::path& file,
                                                                 Database& db);
  /// Opens, migrates an older version, and loads into `db`, which must hold no nodes; types that the file
  /// knows and the database does not are defined. Rules run over what was loaded; there is nothing to undo
  /// afterwards. Errors: not_found, bad_input (no world, a newer version, a type that differs, cut short, a
  /// rule's veto), not_writable (for read_write), wrong_state (the database has nodes). With read_only the
  /// file stays as it is, whatever its version, and persist() is refused.
  [[nodiscard]] static Result<std::unique_ptr<WorldFile>> open(const std::filesystem::path& file,
                                                               Database& db,
                                                               Access access = Access::read_write);
  ~WorldFile();
  WorldFile(const WorldFile&) = delete;
  WorldFile& operator=(const WorldFile&) = delete;

  /// World thread. Writes what has changed since the last call, in one transaction of SQLite, and returns
  /// when it is safe on the disk. Errors: disk_full, io (another program has the file locked, or has written
  /// to it), not_writable, bad_input (values of one node beyond 1 GB). After an error the file holds what was
  /// acknowledged last, and the next call tries again.
  [[nodiscard]] Status persist();

  struct Impl;

 private:
  explicit WorldFile(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// The whole world as YAML, nodes by id, attributes that differ from their default; blobs as base64. The same
/// world gives the same bytes. Errors: not_writable, disk_full.
[[nodiscard]] Status export_world_yaml(const Snapshot& world, const std::filesystem::path& file);
/// Into a database without nodes. Errors: not_found, bad_input with line and column.
[[nodiscard]] Status import_world_yaml(const std::filesystem::path& file, Database& db);
[[nodiscard]] std::string world_yaml(const Snapshot& world);

}  // namespace rigor::world
