#include "sim/world/store/sqlite.h"

#include <sqlite3.h>

#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>

namespace rigor::world::store {
namespace {

static_assert(std::endian::native == std::endian::little, "blobs in a world file are little-endian");

/// How long a call waits for another program that has the file locked.
constexpr int kBusyWait_ms = 5000;

bool no_space(int system_error) { return system_error == ENOSPC || system_error == EDQUOT; }

/// What a code of SQLite means to the user. `sqlite_text` is SQLite's own sentence.
Error describe(int code, int system_error, const std::string& file, const std::string& sqlite_text) {
  const int extended = code;
  code &= 0xFF;
  if (code == SQLITE_FULL || (code == SQLITE_IOERR && no_space(system_error)))
    return {ErrorCode::disk_full, file, "no space is left for the world; make room and try again"};
  switch (code) {
    case SQLITE_NOTADB:
      return {ErrorCode::bad_input, file,
              "expected a Rigor world (an SQLite file), got a file of another kind; give a file that Rigor "
              "wrote"};
    case SQLITE_CORRUPT:
      return {ErrorCode::bad_input, file,
              "the world is damaged or cut short (" + sqlite_text + "); restore it from a copy"};
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return {ErrorCode::io, file,
              "another program has the world locked; end its transaction (or the program) and try again"};
    case SQLITE_READONLY:
      if (extended == SQLITE_READONLY_DBMOVED)
        return {ErrorCode::io, file, "the file was moved or removed while it was open; put it back"};
      if (extended == SQLITE_READONLY_ROLLBACK || extended == SQLITE_READONLY_CANTLOCK)
        return {
            ErrorCode::not_writable, file,
            "the last program that wrote here was cut off, and its unfinished write must be undone first; "
            "open the world once with the right to write"};
      return {ErrorCode::not_writable, file,
              "the world cannot be written; give it and its folder the right to write, or work on a copy"};
    case SQLITE_CANTOPEN:
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return {ErrorCode::not_writable, file,
              "the file or one beside it cannot be opened (" +
                  (system_error ? std::string(std::strerror(system_error)) : sqlite_text) +
                  "); check the rights of the file and of its folder"};
    case SQLITE_TOOBIG:
      return {ErrorCode::bad_input, file,
              "the values of one node take more than the 1 GB that a world file can hold; split them"};
    case SQLITE_ERROR:
    case SQLITE_CONSTRAINT:
    case SQLITE_MISMATCH:
      return {ErrorCode::bad_input, file,
              "the tables of the world are not as Rigor makes them (" + sqlite_text +
                  "); mend them with sqlite3, or restore the file from a copy"};
    case SQLITE_NOMEM:
      return {ErrorCode::unavailable, file, "out of memory"};
    default: {
      std::string text = "reading or writing the world failed: " + sqlite_text;
      if (code == SQLITE_IOERR && system_error != 0)
        text += std::string(" (") + std::strerror(system_error) + ")";
      return {ErrorCode::io, file, text};
    }
  }
}

}  // namespace

// ---------------------------------------------------------------- connection

void Sqlite::open_at(const char* name, int flags) {
  const int code = sqlite3_open_v2(name, &db_, flags | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_EXRESCODE, nullptr);
  if (db_ == nullptr) {
    refuse(ErrorCode::unavailable, "out of memory");
    return;
  }
  if (code != SQLITE_OK) return fail_with(code);
  sqlite3_busy_timeout(db_, kBusyWait_ms);
  sqlite3_db_config(db_, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  // A file from elsewhere may hold triggers and views that call functions.
  sqlite3_db_config(db_, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(db_, SQLITE_DBCONFIG_ENABLE_TRIGGER, 0, nullptr);
  // A double-quoted word is a name, never text.
  sqlite3_db_config(db_, SQLITE_DBCONFIG_DQS_DML, 0, nullptr);
  sqlite3_db_config(db_, SQLITE_DBCONFIG_DQS_DDL, 0, nullptr);
}

std::unique_ptr<Sqlite> Sqlite::open(const std::filesystem::path& file, Mode mode) {
  std::unique_ptr<Sqlite> db(new Sqlite(file));
  int flags = SQLITE_OPEN_READWRITE;
  if (mode == Mode::read) flags = SQLITE_OPEN_READONLY;
  if (mode == Mode::create) flags |= SQLITE_OPEN_CREATE;
  // ":memory:" and "" mean something else to SQLite.
  db->open_at(file.has_parent_path() ? file.c_str() : (std::filesystem::path(".") / file).c_str(), flags);
  return db;
}

std::unique_ptr<Sqlite> Sqlite::open_in_memory(const std::filesystem::path& named) {
  std::unique_ptr<Sqlite> db(new Sqlite(named));
  db->open_at(":memory:", SQLITE_OPEN_READWRITE);
  return db;
}

bool Sqlite::exists(const std::filesystem::path& file) {
  sqlite3_vfs* vfs = sqlite3_vfs_find(nullptr);
  int there = 0;
  if (vfs == nullptr) return false;
  // An empty file counts as none for xAccess(EXISTS) of the unix VFS.
  std::error_code ec;
  return (vfs->xAccess(vfs, file.c_str(), SQLITE_ACCESS_EXISTS, &there) == SQLITE_OK && there != 0) ||
         std::filesystem::exists(std::filesystem::symlink_status(file, ec));
}

Sqlite::~Sqlite() {
  if (db_ != nullptr) sqlite3_close_v2(db_);
}

void Sqlite::fail_with(int code) {
  if (!ok_) return;
  ok_ = false;
  error_ = describe(code, sqlite3_system_errno(db_), file_.string(), sqlite3_errmsg(db_));
}

void Sqlite::refuse(ErrorCode code, std::string message) {
  if (!ok_) return;
  ok_ = false;
  error_ = {code, file_.string(), std::move(message)};
}

Status Sqlite::status() const {
  if (ok_) return {};
  return tl::unexpected<Error>(error_);
}

bool Sqlite::is_read_only() const { return db_ != nullptr && sqlite3_db_readonly(db_, "main") == 1; }

void Sqlite::roll_back() noexcept {
  if (db_ != nullptr && sqlite3_get_autocommit(db_) == 0)
    sqlite3_exec(db_, "ROLLBACK", nullptr, nullptr, nullptr);
}

void Sqlite::run(const std::string& sql) {
  if (!ok_) return;
  const int code = sqlite3_exec(db_, sql.c_str(), nullptr, nullptr, nullptr);
  if (code != SQLITE_OK) fail_with(code);
}

Statement Sqlite::prepare(std::string_view sql) {
  Statement s;
  s.owner_ = this;
  if (!ok_) return s;
  const int code = sqlite3_prepare_v2(db_, sql.data(), static_cast<int>(sql.size()), &s.statement_, nullptr);
  if (code != SQLITE_OK) fail_with(code);
  return s;
}

std::int64_t Sqlite::integer(std::string_view sql) {
  auto s = prepare(sql);
  return s.step() ? s.integer(0) : 0;
}

std::string Sqlite::text(std::string_view sql) {
  auto s = prepare(sql);
  return s.step() ? s.text(0) : "";
}

void Sqlite::copy_from(Sqlite& from) {
  if (!ok_ || !from.ok_) return;
  sqlite3_backup* backup = sqlite3_backup_init(db_, "main", from.db_, "main");
  if (backup == nullptr) return fail_with(sqlite3_extended_errcode(db_));
  sqlite3_backup_step(backup, -1);
  const int code = sqlite3_backup_finish(backup);
  if (code != SQLITE_OK) fail_with(code);
}

// ---------------------------------------------------------------- statement

Statement::Statement(Statement&& o) noexcept : owner_(o.owner_), statement_(o.statement_) {
  o.statement_ = nullptr;
}
Statement& Statement::operator=(Statement&& o) noexcept {
  if (this != &o) {
    sqlite3_finalize(statement_);
    owner_ = o.owner_;
    statement_ = o.statement_;
    o.statement_ = nullptr;
  }
  return *this;
}
Statement::~Statement() { sqlite3_finalize(statement_); }

Statement& Statement::bind(int at, std::int64_t value) {
  if (!owner_->ok_) return *this;
  const int code = sqlite3_bind_int64(statement_, at + 1, value);
  if (code != SQLITE_OK) owner_->fail_with(code);
  return *this;
}
Statement& Statement::bind(int at, std::string_view text) {
  if (!owner_->ok_) return *this;
  const int code = sqlite3_bind_text64(statement_, at + 1, text.empty() ? "" : text.data(), text.size(),
                                       SQLITE_STATIC, SQLITE_UTF8);
  if (code != SQLITE_OK) owner_->fail_with(code);
  return *this;
}
Statement& Statement::bind_blob(int at, std::span<const std::byte> bytes) {
  if (!owner_->ok_) return *this;
  const int code = bytes.empty()
                       ? sqlite3_bind_zeroblob(statement_, at + 1, 0)
                       : sqlite3_bind_blob64(statement_, at + 1, bytes.data(), bytes.size(), SQLITE_STATIC);
  if (code != SQLITE_OK) owner_->fail_with(code);
  return *this;
}
Statement& Statement::bind_number(int at, double value) {
  if (!owner_->ok_) return *this;
  int code = SQLITE_OK;
  if (std::isnan(value))
    code = sqlite3_bind_null(statement_, at + 1);
  else if (value == 0 && std::signbit(value))
    code = sqlite3_bind_blob(statement_, at + 1, &value, sizeof value, SQLITE_TRANSIENT);
  else
    code = sqlite3_bind_double(statement_, at + 1, value);
  if (code != SQLITE_OK) owner_->fail_with(code);
  return *this;
}
Statement& Statement::bind_null(int at) {
  if (!owner_->ok_) return *this;
  const int code = sqlite3_bind_null(statement_, at + 1);
  if (code != SQLITE_OK) owner_->fail_with(code);
  return *this;
}

bool Statement::step() {
  if (!owner_->ok_) return false;
  const int code = sqlite3_step(statement_);
  if (code == SQLITE_ROW) return true;
  if (code != SQLITE_DONE) owner_->fail_with(code);
  return false;
}
void Statement::run() {
  while (step()) {
  }
  reset();
}
void Statement::reset() {
  if (statement_ == nullptr) return;
  sqlite3_reset(statement_);  // its code is that of the step, which has been told
  sqlite3_clear_bindings(statement_);
}

Statement::Kind Statement::kind(int column) const {
  switch (sqlite3_column_type(statement_, column)) {
    case SQLITE_INTEGER:
      return Kind::integer;
    case SQLITE_FLOAT:
      return Kind::real;
    case SQLITE_TEXT:
      return Kind::text;
    case SQLITE_BLOB:
      return Kind::blob;
    default:
      return Kind::null;
  }
}
std::int64_t Statement::integer(int column) const { return sqlite3_column_int64(statement_, column); }
double Statement::real(int column) const { return sqlite3_column_double(statement_, column); }
std::string Statement::text(int column) const {
  const auto* p = reinterpret_cast<const char*>(sqlite3_column_text(statement_, column));
  const auto n = static_cast<std::size_t>(sqlite3_column_bytes(statement_, column));
  return p ? std::string(p, n) : std::string();
}
std::span<const std::byte> Statement::blob(int column) const {
  const auto* p = static_cast<const std::byte*>(sqlite3_column_blob(statement_, column));
  const auto n = static_cast<std::size_t>(sqlite3_column_bytes(statement_, column));
  return p ? std::span<const std::byte>(p, n) : std::span<const std::byte>();
}

std::string sql_name(std::string_view name) {
  std::string s = "\"";
  for (const char c : name) {
    if (c == '"') s += '"';
    s += c;
  }
  return s + '"';
}

}  // namespace rigor::world::store
