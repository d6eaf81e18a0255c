// A run's recording in place of its devices and simulated sensors.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "bench/run/assembly.h"
#include "bench/run/recording.h"
#include "sensor-hal/record/replay_source.h"

namespace rigor {

/// A recording that is to be replayed.
struct ReplayInput {
  std::filesystem::path file;
  RecordedRun run;
  std::shared_ptr<const Recording> recording;
  [[nodiscard]] std::uint64_t cycles() const { return run.cycles > 0 ? run.cycles : recording->cycles(); }
};
/// not_found, protocol; bad_input where it is not a recording of a run.
[[nodiscard]] Result<ReplayInput> open_replay(const std::filesystem::path& file);

/// The rig in the recording. A recording may come from anybody: one whose application is a program or a
/// library of its own is refused (bad_input) unless `run_program` is set or an override names it; without it,
/// its plugins are not loaded either, and an application that `registry` does not have is refused.
[[nodiscard]] Result<RigConfig> recorded_rig(const ReplayInput& input,
                                             const std::vector<ConfigOverride>& overrides,
                                             const Registry& registry, bool run_program);

/// As `assemble`, with sources that show what was recorded and sinks that move nothing. Virtual time, for as
/// many cycles as the recording has. Setup context.
[[nodiscard]] Result<std::unique_ptr<Assembly>> assemble_replay(RigConfig rig, const Registry& registry,
                                                                const ReplayInput& input);

}  // namespace rigor
