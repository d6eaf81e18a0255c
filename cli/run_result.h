// What a run was like, as JSON: the one source of `--json`, of the text summary and of the HTML report.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "cli/bench_run.h"

namespace rigor {

struct RunContextText {
  std::string engine;     ///< what rendered
  std::string utc;        ///< of t0, ISO 8601
  std::string recording;  ///< file, or empty
};

/// Setup context, after the loop has ended.
[[nodiscard]] nlohmann::json run_result(const RunParts& parts, const RunOutcome& outcome,
                                        const Recorder* recorder, const RunContextText& text);
/// A few lines for people.
[[nodiscard]] std::string summary_text(const nlohmann::json& result);

}  // namespace rigor
