// What came of a run.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bench/expect/expected.h"
#include "bench/result/verdict.h"
#include "bench/run/run_outcome.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

struct RunReport {
  RunOutcome outcome;              ///< of the loop; the digest of what the application saw
  RunFacts facts;                  ///< channels, sinks, application: what was due, came, was late or lost
  Verdict verdict;                 ///< on these
  FindingSet failed_on;            ///< findings that were asked to fail the run
  std::vector<Expected> expected;  ///< what the rig expects, and how it came out
  std::vector<AnalysisReport> analyses;
  std::vector<std::string> warnings;  ///< of channels
  std::vector<Error> errors;          ///< of closing devices and writing files
  std::string replay_difference;      ///< a replay that saw something else says so; empty: it did not
  std::filesystem::path recording, page, trace, junit;  ///< that were written; empty: none

  std::string json;  ///< all of it, one object (docs/report.md)
  std::string text;  ///< a summary in lines

  /// The loop did not break off.
  [[nodiscard]] bool ended_well() const;
  /// It ended well, all that was expected held, no finding failed it, nothing went wrong in closing, and its
  /// devices were there. Exit status 0 of `rigor run`.
  [[nodiscard]] bool passed() const;
};

}  // namespace rigor
