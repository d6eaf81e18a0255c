// Recordings of a satellite receiver, UBX and NMEA as it sent them: `rigor inspect` and `rigor convert`.
#pragma once

#include <filesystem>

#include "calibration/procedures/recording_input.h"
#include "cli/commands.h"
#include "rt-core/time.h"

namespace rigor {

/// By its name (.ubx, .nmea), or of a .log by a message at its beginning.
[[nodiscard]] bool is_receiver_log(const std::filesystem::path& file);
/// Solutions as fixes, at the distances of the receiver's own time from the first. not_found, bad_input (no
/// solution in it).
[[nodiscard]] Result<RecordingInput> read_receiver_log(const std::filesystem::path& file,
                                                       const TakeSample& take);
/// UTC of the first solution; that of virtual runs where the receiver never knew the date.
[[nodiscard]] RealtimeTime begin_of_receiver_log(const std::filesystem::path& file);
int inspect_receiver_log_command(const InspectOptions& options);

}  // namespace rigor
