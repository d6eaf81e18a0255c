// SQLite as the store needs it: connections and statements that close themselves, and one error for a whole
// series of calls. After a call has failed, all further ones on its connection do nothing, and `status` tells
// what went wrong first; so a series is written as if nothing failed, and judged once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "rt-core/result.h"

struct sqlite3;
struct sqlite3_stmt;

namespace rigor::world::store {

class Statement;

class Sqlite {
 public:
  enum class Mode : std::uint8_t { read, write, create };
  /// The file is not looked at before the first read. Uses SQLite's default VFS.
  [[nodiscard]] static std::unique_ptr<Sqlite> open(const std::filesystem::path& file, Mode mode);
  [[nodiscard]] static std::unique_ptr<Sqlite> open_in_memory(const std::filesystem::path& named);
  /// By the VFS that `open` uses.
  [[nodiscard]] static bool exists(const std::filesystem::path& file);
  ~Sqlite();
  Sqlite(const Sqlite&) = delete;
  Sqlite& operator=(const Sqlite&) = delete;

  /// Statements without results, separated by `;`.
  void run(const std::string& sql);
  [[nodiscard]] Statement prepare(std::string_view sql);
  /// The first column of the first row, or 0.
  [[nodiscard]] std::int64_t integer(std::string_view sql);
  [[nodiscard]] std::string text(std::string_view sql);
  /// All pages of `from`, as they lie.
  void copy_from(Sqlite& from);

  [[nodiscard]] bool ok() const noexcept { return ok_; }
  /// What failed first, in the words of a user's message.
  [[nodiscard]] Status status() const;
  /// Refuses further calls; keeps the first refusal.
  void refuse(ErrorCode code, std::string message);
  [[nodiscard]] bool is_read_only() const;
  /// Undoes an open transaction, also after a failure.
  void roll_back() noexcept;

 private:
  friend class Statement;
  explicit Sqlite(std::filesystem::path file) : file_(std::move(file)) {}
  void open_at(const char* name, int flags);
  void fail_with(int code);
  std::filesystem::path file_;
  sqlite3* db_ = nullptr;
  bool ok_ = true;
  Error error_;
};

/// Parameters and columns count from 0. Text and blobs that are bound must stay until the statement has run.
class Statement {
 public:
  Statement() = default;
  Statement(Statement&& o) noexcept;
  Statement& operator=(Statement&& o) noexcept;
  ~Statement();

  Statement& bind(int at, std::int64_t value);
  Statement& bind(int at, std::string_view text);
  Statement& bind_blob(int at, std::span<const std::byte> bytes);
  /// Exact: NaN becomes NULL, and -0.0 a BLOB of its bits, since SQLite keeps neither as REAL.
  Statement& bind_number(int at, double value);
  Statement& bind_null(int at);
  /// True where there is a row.
  [[nodiscard]] bool step();
  /// Steps to the end and makes the statement ready for the next parameters.
  void run();
  void reset();

  enum class Kind : std::uint8_t { null, integer, real, text, blob };
  [[nodiscard]] Kind kind(int column) const;
  [[nodiscard]] std::int64_t integer(int column) const;
  [[nodiscard]] double real(int column) const;
  [[nodiscard]] std::string text(int column) const;
  /// Good until the next step.
  [[nodiscard]] std::span<const std::byte> blob(int column) const;

 private:
  friend class Sqlite;
  Sqlite* owner_ = nullptr;
  sqlite3_stmt* statement_ = nullptr;
};

/// "name" with its quotes doubled: as an identifier in SQL.
[[nodiscard]] std::string sql_name(std::string_view name);

}  // namespace rigor::world::store
