// What came of one run of a sweep: its row of the table.
#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/sweep/child_run.h"
#include "rt-core/result.h"

namespace rigor::sweep {

/// How an expectation of the rig came out in one run.
struct RowExpectation {
  std::string name;    ///< "turntable.position value from -45 to 45"
  std::string state;   ///< holds, violated, undecided, unknown
  double outside = 0;  ///< share of what was looked at that lay outside of the bounds
  double beyond = 0;   ///< by how much the worst of it did, in the quantity's unit
};

struct Row {
  std::uint64_t index = 0;
  /// passed; failed: it ran to its end, and what the rig expects did not hold; error: it could not run, or
  /// broke off; crashed: a signal ended it; timeout.
  std::string status;
  std::string reason;        ///< why it did not pass
  std::string verdict;       ///< good, warning, bad; empty where there is no report
  std::string input_sha256;  ///< of what the application saw
  std::vector<RowExpectation> expectations;
  /// By name, such as "localization median_m", "right rate_hz". NaN: the run reports it and does not know it.
  std::map<std::string, double> metrics;
  double wall_s = 0;  ///< that the process took; the one number that depends on the machine

  [[nodiscard]] bool passed() const { return status == "passed"; }
  /// Whether what happened may be the machine's doing, so that another attempt may come out otherwise.
  [[nodiscard]] bool may_be_retried() const {
    return status == "error" || status == "crashed" || status == "timeout";
  }
};

[[nodiscard]] nlohmann::json to_json(const Row& row);
/// Empty where it is no row.
[[nodiscard]] std::optional<Row> row_from_json(const nlohmann::json& json);

/// Of a process that ran `rigor run --json`. Errors are those after which no run can go on, and after which
/// the same run may be tried again: disk_full; unavailable: it was stopped, or told to end by a signal before
/// its end.
[[nodiscard]] Result<Row> row_of(std::uint64_t index, const ChildEnd& end);

}  // namespace rigor::sweep
