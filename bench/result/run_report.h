// What came of a run, as plain values: they outlive the run and its devices. JSON, text and HTML are made of
// this struct and of nothing else.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bench/expect/expected.h"
#include "bench/result/verdict.h"
#include "bench/run/report_parts.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

struct RunReport {
  RunIdentity identity;
  RunOutcome outcome;                   ///< of the loop; the digest of what the application saw
  RunFacts facts;                       ///< what was due, came, was late or lost: the verdict's basis
  std::vector<ChannelReport> channels;  ///< in the order of `facts.channels`
  std::vector<SinkReport> sinks;
  std::vector<RunBridgeReport> bridges;
  std::vector<ChannelFaultReport> faults;  ///< of channels that had any
  std::vector<SensorTimeReport> sensor_times;
  std::optional<RecordingReport> recorded;
  Verdict verdict;                 ///< on the facts
  FindingSet fail_on, failed_on;   ///< findings that were to fail the run, and those of them that were found
  std::vector<Expected> expected;  ///< what the rig expects, and how it came out
  std::vector<AnalysisReport> analyses;
  std::vector<std::string> warnings;  ///< of channels
  std::vector<Error> errors;          ///< of closing devices and writing files
  std::string replay_difference;      ///< a replay that saw something else says so; empty: it did not
  std::filesystem::path recording, page, trace, junit;  ///< that were written; empty: none

  /// All of it, one object (docs/report.md).
  [[nodiscard]] std::string json() const;
  /// A summary in lines.
  [[nodiscard]] std::string text() const;

  /// Of bench time.
  [[nodiscard]] double duration_s() const;
  /// The loop did not break off.
  [[nodiscard]] bool ended_well() const;
  /// It ended well, all that was expected held, no finding failed it, nothing went wrong in closing, and its
  /// devices were there. Exit status 0 of `rigor run`.
  [[nodiscard]] bool passed() const;
};

}  // namespace rigor
