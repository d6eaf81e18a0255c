// A sweep as a job array of Slurm: the scripts that it consists of, and their submission.
//
//   slurm/runs.sh     a task of the array: `rigor sweep --index` with its number
//   slurm/report.sh   when all tasks have ended, however they did: table and report
//
// Slurm's limits decide how many tasks there are: of more runs than that each task makes several.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "bench/sweep/sweep_folder.h"
#include "rt-core/result.h"

namespace rigor::sweep {

struct SlurmJobs {
  std::string array, report;  ///< numbers of the jobs
  std::uint64_t tasks = 0;
  std::vector<std::string> commands;  ///< that submitted them, as a shell takes them
};

/// Writes the scripts and submits them: runs that have no row, and a report that waits for the end of them.
/// `options`: further words for `sbatch`, of both jobs. not_found: no `sbatch`; unavailable: it refused, with
/// what it said.
[[nodiscard]] Result<SlurmJobs> submit_to_slurm(const Folder& folder,
                                                const std::vector<std::optional<Row>>& rows,
                                                const std::vector<std::string>& options, double timeout_s);

/// "0-4,7,9-10" of numbers in ascending order.
[[nodiscard]] std::string index_ranges(const std::vector<std::uint64_t>& numbers);

}  // namespace rigor::sweep
