// The folder of a sweep.
//
//   sweep.json        the manifest
//   runs/000017.json  what came of run 17: written when it has ended, whole or not at all
//   work/             where runs work; empty while none does
//   table.csv, index.html
//
// A kill at any instant leaves whole files alone: each is written under another name, put on the medium, and
// renamed.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bench/sweep/sweep_plan.h"
#include "bench/sweep/sweep_row.h"

namespace rigor::sweep {

class Folder {
 public:
  enum class Hold : std::uint8_t {
    alone,  ///< nobody else makes runs in it meanwhile
    shared  ///< others may make other runs of it
  };
  /// Makes the folder where it is not there, and holds it until this is destroyed, or the process ends. With
  /// Hold::alone, what ended processes left in work/ is removed. bad_input: another process holds it, or
  /// something else is in it; not_writable, disk_full.
  [[nodiscard]] static Result<Folder> open(const std::filesystem::path& dir, Hold hold);
  ~Folder();
  Folder(Folder&& o) noexcept;
  Folder& operator=(Folder&&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return dir_; }
  /// The plan whose manifest is there; empty: none is. bad_input as SweepPlan::from_manifest.
  [[nodiscard]] Result<std::optional<SweepPlan>> plan() const;
  /// Writes the plan's manifest where there is none. bad_input: there is another one, with the first
  /// difference.
  [[nodiscard]] Status begin(const SweepPlan& plan) const;

  /// What came of a run; empty: it has not ended, or its file is not readable.
  [[nodiscard]] std::optional<Row> row(std::uint64_t index) const;
  /// Of all runs of a plan, by index.
  [[nodiscard]] std::vector<std::optional<Row>> rows(const SweepPlan& plan) const;
  /// A new folder in work/, of the caller's own.
  [[nodiscard]] Result<std::filesystem::path> make_work_folder() const;
  /// Writes the row of a run that worked in `work`, and removes that. Any thread.
  [[nodiscard]] Status finish(const Row& row, const std::filesystem::path& work) const;
  /// Forgets what came of a run.
  void remove_row(std::uint64_t index) const;

 private:
  Folder(std::filesystem::path dir, int lock) : dir_(std::move(dir)), lock_(lock) {}
  [[nodiscard]] std::filesystem::path row_file(std::uint64_t index) const;
  std::filesystem::path dir_;
  int lock_ = -1;
};

}  // namespace rigor::sweep
