// Recordings as the input of a calibration: the samples of one channel, one after the other.
#pragma once

#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Given each sample in the order of the recording; false: enough. The sample is valid during the call.
using TakeSample = std::function<bool(const Sample&)>;

struct RecordingInput {
  std::string topic;                  ///< of an MCAP file; else what the samples came from
  std::uint64_t samples = 0;          ///< that were given
  std::vector<std::string> warnings;  ///< a recording that was cut short, chunks that are damaged
};

/// Whether the file's name is that of a recording that read_samples() knows.
[[nodiscard]] bool is_recording(const std::filesystem::path& file);

/// Reads an MCAP file, or point clouds from packets of a LiDAR (recording_packets.h). `channel` is a rig's
/// channel (`left`), one side of a pair (`left/real`), or a topic
/// (`/camera/image_raw`); where it is empty, the file must have only one channel of that kind. One thread;
/// allocates. Errors: not_found (no such file), bad_input (no such channel, several, none of the kind: those
/// that there are are listed; no sample in it), protocol (damaged).
[[nodiscard]] Result<RecordingInput> read_samples(const std::filesystem::path& file,
                                                  const std::string& channel, SampleKind kind,
                                                  const TakeSample& take);

/// Of which kind a channel of a recording is, of `kinds`. Packets of a LiDAR are point clouds. Errors:
/// bad_input (there is none of that name: those that there are are listed), those of opening it.
[[nodiscard]] Result<SampleKind> kind_of_channel(const std::filesystem::path& file,
                                                 const std::string& channel,
                                                 std::span<const SampleKind> kinds);

}  // namespace rigor
