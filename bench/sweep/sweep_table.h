// The table of a sweep: CSV, a row for each run in the order of their indices.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bench/sweep/sweep_plan.h"
#include "bench/sweep/sweep_row.h"

namespace rigor::sweep {

/// RFC 4180, with a header; `nan` is a number that the run reports and does not know, an empty cell is one
/// that it does not report. A run without a row has the status "not run". A function of plan and rows alone:
/// what depends on the machine is left out.
[[nodiscard]] std::string table_text(const SweepPlan& plan, const std::vector<std::optional<Row>>& rows);

/// Names of all expectations, in the order in which runs have them, and of all metrics in that of the
/// letters.
struct TableColumns {
  std::vector<std::string> expectations, metrics;
};
[[nodiscard]] TableColumns table_columns(const std::vector<std::optional<Row>>& rows);

}  // namespace rigor::sweep
