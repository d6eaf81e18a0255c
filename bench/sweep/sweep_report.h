// The report of a sweep: one HTML page with each expectation and each metric over each parameter, and the
// commands that repeat the worst runs (docs/sweep.md).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bench/sweep/sweep_plan.h"
#include "bench/sweep/sweep_row.h"

namespace rigor::sweep {

/// A whole page. `rows` by index; empty: not run.
[[nodiscard]] std::string report_page(const SweepPlan& plan, const std::vector<std::optional<Row>>& rows);

/// How many runs came out how.
struct Outcome {
  std::size_t runs = 0, passed = 0, failed = 0, error = 0, crashed = 0, timeout = 0, not_run = 0;
  [[nodiscard]] bool all_passed() const { return passed == runs; }
  /// "198 of 200 runs passed, 1 failed, 1 crashed".
  [[nodiscard]] std::string text() const;
};
[[nodiscard]] Outcome outcome_of(const std::vector<std::optional<Row>>& rows);

}  // namespace rigor::sweep
