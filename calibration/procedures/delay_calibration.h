// By how much the stamps of one channel are off against those of another one.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct DelayCalibrationOptions : CalibrationInputs {
  /// Channels; `CHANNEL:INDEX` of registers, `SINK:VALUE` of commands. The first is the denser one.
  std::string first, second;
  std::string target;                       ///< of a camera: the board whose turning is followed
  std::filesystem::path camera_model_file;  ///< of a camera: its sensor model
  double largest_s = 0.5;                   ///< how far to search
  bool same_quantity = false;               ///< both measure the same in one unit
};

/// `inputs`: one recording (.mcap). `delay_s` > 0: the stamps of the second are early. `notes` say what that
/// means for the latency_ms of the rig. Errors: not_found, bad_input (no such channel, fewer than 8 values),
/// protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_delay(const DelayCalibrationOptions& options,
                                                        const StopToken& stop = {});

}  // namespace rigor
