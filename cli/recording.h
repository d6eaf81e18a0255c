// The recording of a run, between the rig's channels and the recorder.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>

#include "cli/bench_run.h"
#include "rt-core/epoch.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {

/// Refuses an output that cannot be written, before anything else is touched. not_writable.
[[nodiscard]] Status check_writable(const std::filesystem::path& file);

/// The lens of a simulated channel (of a pair: of its twin), as ROS has it; empty where the rig names no
/// sensor.
[[nodiscard]] std::optional<record::msg::CameraInfo> camera_info(const ChannelEntry& entry);

/// Opens the rig's recording, or gives null where it asks for none. Channels are named to the recorder in the
/// order of `parts.channels`. `metadata`: what is known of the run beyond its rig. Setup context, after the
/// channels are configured.
[[nodiscard]] Result<std::unique_ptr<Recorder>> open_recording(RunParts& parts, BenchTime t0,
                                                               const EpochPair& epoch,
                                                               std::map<std::string, std::string> metadata);

/// What a recording says of the run that made it.
struct RecordedRun {
  std::string rig_text, rig_file;
  BenchTime t0;
  EpochPair epoch;
  std::uint64_t cycles = 0;   ///< grid points of the run
  std::string seen_sha256;    ///< as printed by the run, where it could be
  std::uint64_t dropped = 0;  ///< samples that the recorder had to skip
};
[[nodiscard]] std::map<std::string, std::string> run_metadata(const RunParts& parts, const EpochPair& epoch);
/// From the file's metadata; bad_input where it is not a recording of a run.
[[nodiscard]] Result<RecordedRun> read_recorded_run(const std::filesystem::path& file);

}  // namespace rigor
