// What a rig expects, judged over a recording: without a device, an application or a program of its own.
//
// Samples, statuses by cycle, commands, alarms and skipped cycles are in a recording, and are judged as in
// the run. What its sinks, its application and the computer's clock counted is not: such an expectation is
// unknown (Expected::known).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "bench/expect/expected.h"
#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// What came of it.
struct CheckedRecording {
  std::string rig;                 ///< name of the recorded one
  std::vector<Expected> expected;  ///< in the order of the file
  double duration_s = 0;           ///< of the run, as far as it is recorded
  std::uint64_t cycles = 0;        ///< that the loop ran
  bool cut_short = false;          ///< the recording has no end: what is judged is what came before
  std::uint64_t missing_samples =
      0;  ///< visible in the run, but skipped by its recorder: judged by their stamps alone
};

/// What to judge it by.
struct CheckBy {
  std::filesystem::path rig;  ///< its `expect` is taken in place of the recorded rig's; empty: that
  std::vector<ConfigOverride> overrides;  ///< of the rig that has the `expect`
};

/// A recording of a run. bad_input: among others a rig that expects nothing, or something of a channel that
/// was not recorded, with its place. not_found, protocol. Setup context.
[[nodiscard]] Result<CheckedRecording> check_recorded_run(const std::filesystem::path& recording,
                                                          const CheckBy& by);

}  // namespace rigor
