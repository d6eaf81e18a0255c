#include "sim/world/store/world_file.h"

#include <fmt/format.h>

#include <utility>

#include "sim/world/graph/snapshot_state.h"
#include "sim/world/store/dirty_nodes.h"
#include "sim/world/store/load.h"
#include "sim/world/store/save.h"
#include "sim/world/store/sqlite.h"
#include "sim/world/store/tables.h"

namespace rigor::world {

using store::Sqlite;

struct WorldFile::Impl {
  std::filesystem::path file;
  Database* db = nullptr;
  Access access = Access::read_write;
  std::unique_ptr<Sqlite> sql;  ///< null after an error: the next call opens the file anew
  store::DirtyNodes dirty;
  Subscription watch;
  /// The file's count of persists, as known; and the one that the last attempt would have written.
  std::int64_t generation = 0, attempted = 0;
  std::uint64_t next_id = 0;
  store::FileNumbers numbers;
  std::size_t types = 0, attributes = 0, edges = 0;  ///< of the schema that the file is known to have

  void follow() {
    watch = db->subscribe(
        {}, [this](const ChangeSet& set, std::span<const Change> mine) { dirty.note(set, mine); });
  }
  [[nodiscard]] bool knows(const Schema& s) const {
    return types == s.type_count() && attributes == s.attribute_count() && edges == s.edge_type_count();
  }
  void know(const Schema& s) {
    types = s.type_count(), attributes = s.attribute_count(), edges = s.edge_type_count();
  }
  void write(const Snapshot& now);
};

namespace {

/// A rollback journal, and the folder synced after it is gone: with `FULL` alone a journal that comes back
/// after a power cut would undo what was acknowledged.
void make_durable(Sqlite& sql) {
  sql.run(
      "PRAGMA journal_mode = DELETE; PRAGMA synchronous = EXTRA; PRAGMA temp_store = MEMORY;"
      "PRAGMA cell_size_check = ON");
}

constexpr const char* kGeneration = "SELECT value FROM meta WHERE key = 'generation'";

}  // namespace

WorldFile::WorldFile(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
WorldFile::~WorldFile() = default;

Result<std::unique_ptr<WorldFile>> WorldFile::create(const std::filesystem::path& file, Database& db) {
  constexpr const char* kThere =
      "expected no file of this name, got one; open it, remove it, or take another name";
  if (Sqlite::exists(file)) return fail(ErrorCode::bad_input, file.string(), kThere);
  auto impl = std::make_unique<Impl>();
  impl->file = file;
  impl->db = &db;
  impl->sql = Sqlite::open(file, Sqlite::Mode::create);
  auto& sql = *impl->sql;
  make_durable(sql);
  sql.run("BEGIN EXCLUSIVE");
  const bool ours = sql.ok() && sql.integer("SELECT count(*) FROM sqlite_schema") == 0;
  if (sql.ok() && !ours) sql.refuse(ErrorCode::bad_input, kThere);
  if (ours) store::create_tables(sql);
  sql.run("COMMIT");
  if (auto s = sql.status(); !s) {
    sql.roll_back();
    impl->sql.reset();
    std::error_code ec;
    if (ours) std::filesystem::remove(file, ec);
    return tl::unexpected<Error>(s.error());
  }
  impl->dirty.note_all(db.snapshot());
  impl->follow();
  return std::unique_ptr<WorldFile>(new WorldFile(std::move(impl)));
}

namespace {

/// The file, checked and of this version, in a transaction for reading.
Result<std::unique_ptr<Sqlite>> open_checked(const std::filesystem::path& file, WorldFile::Access access) {
  const bool reads = access == WorldFile::Access::read_only;
  if (!Sqlite::exists(file))
    return fail(ErrorCode::not_found, file.string(),
                "expected a world, got nothing: no such file; check the name, or import a world first");
  std::error_code ec;
  if (std::filesystem::is_directory(file, ec))
    return fail(ErrorCode::bad_input, file.string(), "expected a world, got a folder; name a file in it");
  auto sql = Sqlite::open(file, reads ? Sqlite::Mode::read : Sqlite::Mode::write);
  if (sql->ok() && !reads && sql->is_read_only())
    sql->refuse(ErrorCode::not_writable,
                "the world cannot be written; give it and its folder the right to write, or work on a copy");
  sql->run("BEGIN");
  store::check_is_world(*sql);
  const bool old = sql->ok() && sql->integer("PRAGMA user_version") < store::kFileVersion;
  if (old && reads) {
    auto copy = Sqlite::open_in_memory(file);
    sql->run("COMMIT");
    copy->copy_from(*sql);
    if (auto s = sql->status(); !s) return tl::unexpected<Error>(s.error());
    sql = std::move(copy);
    sql->run("BEGIN");
    store::migrate(*sql);
  } else if (!reads) {
    sql->run("COMMIT");
    make_durable(*sql);
    sql->run(old ? "BEGIN EXCLUSIVE" : "BEGIN");
    if (old) {
      store::migrate(*sql);
      sql->run("COMMIT; BEGIN");
    }
  }
  if (auto s = sql->status(); !s) return tl::unexpected<Error>(s.error());
  return sql;
}

}  // namespace

Result<std::unique_ptr<WorldFile>> WorldFile::open(const std::filesystem::path& file, Database& db,
                                                   Access access) {
  if (db.snapshot().node_count() != 0)
    return fail(ErrorCode::wrong_state, file.string(),
                "expected a database without nodes to load the world into");
  auto sql = open_checked(file, access);
  if (!sql) return tl::unexpected<Error>(sql.error());
  auto impl = std::make_unique<Impl>();
  impl->file = file;
  impl->db = &db;
  impl->access = access;
  impl->sql = std::move(*sql);
  if (auto s = store::load(*impl->sql, db, file, impl->dirty); !s) return tl::unexpected<Error>(s.error());
  impl->generation = impl->attempted = impl->sql->integer(kGeneration);
  impl->next_id =
      static_cast<std::uint64_t>(impl->sql->integer("SELECT value FROM meta WHERE key = 'next_node_id'"));
  impl->sql->run("COMMIT");
  if (auto s = impl->sql->status(); !s) return tl::unexpected<Error>(s.error());
  if (access == Access::read_write) impl->follow();
  return std::unique_ptr<WorldFile>(new WorldFile(std::move(impl)));
}

void WorldFile::Impl::write(const Snapshot& now) {
  sql->run("BEGIN IMMEDIATE");
  const auto found = sql->integer(kGeneration);
  if (sql->ok() && found != generation && found != attempted)
    sql->refuse(
        ErrorCode::io,
        fmt::format("another program has written to this world since it was opened (its persist {}, ours "
                    "{}); end one of the two, and open it again",
                    found, generation));
  if (!knows(now.schema())) {
    store::write_schema(*sql, now.schema());
    numbers = store::read_numbers(*sql, now.schema());
  }
  if (sql->ok()) store::save(*sql, numbers, now, dirty);
  if (sql->ok()) attempted = found + 1;
  auto meta = sql->prepare("UPDATE meta SET value = ? WHERE key = ?");
  meta.bind(0, attempted).bind(1, "generation").run();
  meta.bind(0, static_cast<std::int64_t>(now.state().world.next_id)).bind(1, "next_node_id").run();
  sql->run("COMMIT");
}

Status WorldFile::persist() {
  auto& w = *impl_;
  if (w.access == Access::read_only)
    return fail(ErrorCode::not_writable, w.file.string(), "the world was opened for reading alone");
  const Snapshot now = w.db->snapshot();
  if (w.dirty.empty() && w.knows(now.schema()) && w.next_id == now.state().world.next_id) return {};
  if (!w.sql) {
    w.sql = Sqlite::open(w.file, Sqlite::Mode::write);
    make_durable(*w.sql);
    store::check_is_world(*w.sql);
    w.types = w.attributes = w.edges = 0;
  }
  w.write(now);
  if (auto s = w.sql->status(); !s) {
    w.sql->roll_back();
    w.sql.reset();
    return s;
  }
  w.generation = w.attempted;
  w.next_id = now.state().world.next_id;
  w.know(now.schema());
  w.dirty.clear();
  return {};
}

}  // namespace rigor::world
