// Sweeps as commands make them (docs/sweep.md).
//
//   auto sweep = Sweep::open("DIR", options, Folder::Hold::alone, registry);
//   sweep->make({.jobs = 8});        // what is not there yet
//   sweep->write_results();          // DIR/table.csv, DIR/index.html
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bench/sweep/run_sweep.h"
#include "bench/sweep/slurm.h"
#include "bench/sweep/sweep_report.h"

namespace rigor::sweep {

/// Options as people write them; empty: not given.
struct Texts {
  std::filesystem::path rig;
  std::vector<std::string> overrides, vary;  ///< path.to.key=value, path.to.key=VALUES
  std::string seeds, samples, draw_seed, duration;
  std::vector<std::filesystem::path> plugins;
};
/// bad_input with the option's name.
[[nodiscard]] Result<SweepOptions> read_options(const Texts& texts);

/// "17", or `auto`: JOB_COMPLETION_INDEX of an indexed job of Kubernetes, or SLURM_ARRAY_TASK_ID, of the
/// environment. bad_input.
[[nodiscard]] Result<std::uint64_t> read_index(const std::string& text);

class Sweep {
 public:
  /// Takes the folder. With options: begins a sweep there, after it has checked what can be checked before
  /// anything runs, or goes on with the same one. Without options: goes on with the one that is there.
  /// Setup context. Errors as of Folder::open, SweepPlan::create and check; not_found: there is no sweep.
  [[nodiscard]] static Result<Sweep> open(const std::filesystem::path& dir,
                                          const std::optional<SweepOptions>& options, Folder::Hold hold,
                                          const Registry& registry);

  [[nodiscard]] const SweepPlan& plan() const { return plan_; }
  /// Of the rows that the last call but make_some() read or made.
  [[nodiscard]] Outcome outcome() const { return outcome_of(rows_); }
  [[nodiscard]] std::filesystem::path table() const { return folder_.path() / "table.csv"; }
  [[nodiscard]] std::filesystem::path page() const { return folder_.path() / "index.html"; }

  /// Forgets runs that crashed, broke off, could not run or took too long, so that they are made again.
  void retry();
  /// Makes the runs that are missing, as make_runs does.
  [[nodiscard]] Status make(const Work& work);
  /// Makes run `index` and every `every`-th after it, where they are missing. bad_input: no such run.
  [[nodiscard]] Status make_some(std::uint64_t index, std::uint64_t every, const Work& work);
  /// Leaves the missing runs to Slurm.
  [[nodiscard]] Result<SlurmJobs> submit(const std::vector<std::string>& options, double timeout_s);
  /// Writes table and report of the runs that are there.
  [[nodiscard]] Status write_results();

 private:
  Sweep(Folder folder, SweepPlan plan) : folder_(std::move(folder)), plan_(std::move(plan)) {}
  void read_rows();
  Folder folder_;
  SweepPlan plan_;
  std::vector<std::optional<Row>> rows_;  ///< empty: not read, as a single run of many need not
};

}  // namespace rigor::sweep
