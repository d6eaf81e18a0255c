// A disk for SQLite whose power can fail: a VFS in memory that knows what was synced and what was not.
//
// While it lives it is SQLite's default VFS. What is written goes to the page cache of the simulated machine;
// xSync makes a file's bytes durable, the sync of a folder (the first sync of a journal, a deletion with its
// sync) the names in it. `crash` ends the machine: of all that was not durable a random choice happens,
// sector by sector and name by name, in any order.
#pragma once

#include <sqlite3.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace rigor::world::test {

class SimulatedDisk {
 public:
  static constexpr std::size_t kSector = 512;

  SimulatedDisk();
  ~SimulatedDisk();
  SimulatedDisk(const SimulatedDisk&) = delete;
  SimulatedDisk& operator=(const SimulatedDisk&) = delete;

  /// Writes, truncations, syncs, creations and deletions so far.
  [[nodiscard]] std::uint64_t operations() const noexcept { return operations_; }
  /// The operation of this number fails, and all after it.
  void fail_power_at(std::uint64_t operation) { power_fails_at_ = operation; }
  [[nodiscard]] bool power_failed() const noexcept { return dead_; }
  /// Only when no connection is left. The machine is on again afterwards.
  void crash(std::uint64_t seed);

  /// The write of this number returns SQLITE_FULL, once.
  void fill_at(std::uint64_t write) { full_at_ = write; }
  [[nodiscard]] std::uint64_t writes() const noexcept { return writes_; }
  /// All files together hold at most this many bytes.
  void limit(std::optional<std::size_t> bytes) { limit_ = bytes; }
  [[nodiscard]] bool contains(const std::string& name) const { return names_.contains(name); }
  [[nodiscard]] std::size_t bytes() const;

 private:
  friend struct SimulatedDiskCalls;
  struct Write {
    std::size_t offset = 0;
    std::vector<std::byte> bytes;
    bool truncates = false;  ///< to `offset`
  };
  struct Inode {
    std::vector<std::byte> now, durable;
    std::vector<Write> pending;
  };
  struct NameChange {
    std::string name;
    std::shared_ptr<Inode> inode;  ///< null: deleted
  };
  /// What fails now may have happened, in part: it is left to the crash.
  enum class Power : std::uint8_t { on, fails, off };
  Power operate();
  void sync_folder();

  std::map<std::string, std::shared_ptr<Inode>> names_, durable_names_;
  std::vector<NameChange> name_changes_;
  std::uint64_t operations_ = 0, writes_ = 0;
  std::optional<std::uint64_t> power_fails_at_, full_at_;
  std::optional<std::size_t> limit_;
  bool dead_ = false;
  sqlite3_vfs vfs_{};
  sqlite3_vfs* before_ = nullptr;
};

}  // namespace rigor::world::test
