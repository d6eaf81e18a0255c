// The sensor model with which the simulated side of a recorded pair would be its device.
#pragma once

#include <limits>

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct PairCalibrationOptions : CalibrationInputs {
  /// Seconds of the run: captures that count. Without either, a device that changes is an error.
  double from_s = -std::numeric_limits<double>::infinity();
  double until_s = std::numeric_limits<double>::infinity();
};

/// `inputs`: one recording (.mcap) of a run with a pair, and its rig (.yaml) where not the recorded copy
/// counts. `base`: the sensor model that the simulated side had; empty: that of the rig. `model`: of cameras
/// also `principal-point` and `lens`, of LiDARs `ranges`. `notes` have the new mount as `--set`. Details:
/// `channel`, `pairs`, `passes`, residuals before and after. Errors: not_found, bad_input (no pair, no sensor
/// model, fewer than 8 pairs, a device that changed), protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_pair(const PairCalibrationOptions& options,
                                                       const StopToken& stop = {});

}  // namespace rigor
