// What a run was like, as JSON: the one source of `--json`, of the text summary and of the HTML report.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bench/result/run_facts.h"
#include "bench/run/bench_run.h"

namespace rigor {

struct RunContextText {
  std::string engine;          ///< what rendered
  std::string utc;             ///< of t0, ISO 8601
  bool virtual_epoch = false;  ///< that is where all virtual runs begin, and not when this one was
  std::string recording;       ///< file, or empty
  std::string command;         ///< as typed, without secrets
  std::string machine;         ///< name, processor, kernel
};

/// What the verdict rests on, of a run that has ended. Setup context.
[[nodiscard]] RunFacts ended_run_facts(const RunParts& parts, const RunOutcome& outcome,
                                       const Recorder* recorder, const std::vector<std::string>& warnings);
/// With its `verdict`, and `warnings`: of its findings those that are more than notes. Setup context, after
/// the loop has ended.
[[nodiscard]] nlohmann::json run_result(const RunParts& parts, const RunOutcome& outcome,
                                        const Recorder* recorder, const RunContextText& text,
                                        const RunFacts& facts, const Verdict& verdict);
/// A few lines for people.
[[nodiscard]] std::string summary_text(const nlohmann::json& result);

}  // namespace rigor
