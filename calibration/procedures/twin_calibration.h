// How far the simulated side of a pair is from the real one: bias, spread, noise.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct TwinCalibrationOptions : CalibrationInputs {
  std::string real, simulated;  ///< channels, where they are not the two sides of the pair `channel`
  double tolerance_ms = 1;      ///< samples are of one instant within so much
};

/// `inputs`: recordings (.mcap). Compares what both measured, in DN for images and metres for ranges; there
/// is no sensor model to fit, and what is saved are the differences. Errors: not_found, bad_input (no such
/// channel, no samples of one instant), protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_twin(const TwinCalibrationOptions& options,
                                                       const StopToken& stop = {});

}  // namespace rigor
