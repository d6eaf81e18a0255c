// A report of a run as JSON: `--json`, and what the HTML page is made of.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "bench/result/run_report.h"

namespace rigor {

/// docs/report.md has its keys.
[[nodiscard]] nlohmann::json report_json(const RunReport& report);

}  // namespace rigor
