// Makes runs of a sweep: each in a process of its own, so that its memory goes with it and its crash is a
// row.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "bench/sweep/sweep_folder.h"
#include "rt-core/stop.h"

namespace rigor::sweep {

struct Work {
  unsigned jobs = 0;     ///< runs at once; 0: as many as the process may use processors
  double timeout_s = 0;  ///< of a run; 0: none
  StopToken stop;
};

/// Makes one run, whatever came of it before, and writes its row. Blocks until it has ended. Any thread.
/// Errors end a sweep, which can go on later: disk_full, not_writable, io; unavailable: it was interrupted;
/// not_found: the program `rigor` is not there.
[[nodiscard]] Result<Row> make_run(const SweepPlan& plan, const Folder& folder, std::uint64_t index,
                                   const Work& work);

/// Makes those runs that have no row, and fills `rows` with them; a progress line says how far it has come.
/// The first error ends it when the runs at work have been stopped.
[[nodiscard]] Status make_runs(const SweepPlan& plan, const Folder& folder,
                               std::vector<std::optional<Row>>& rows, const Work& work);

}  // namespace rigor::sweep
