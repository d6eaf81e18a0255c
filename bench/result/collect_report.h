// Takes what came of a run from its channels, sinks and faults into a report.
#pragma once

#include "bench/result/run_report.h"
#include "bench/run/bench_run.h"

namespace rigor {

/// What the verdict rests on, of a run that has ended. Setup context.
[[nodiscard]] RunFacts ended_run_facts(const RunParts& parts, const RunOutcome& outcome,
                                       const Recorder* recorder, const std::vector<std::string>& warnings);
/// Adds channels, sinks, faults, times of sensors and the recording to `report`. Setup context, after the
/// loop has ended; the outcome is there.
void collect_parts(const RunParts& parts, const Recorder* recorder, RunReport& report);

}  // namespace rigor
