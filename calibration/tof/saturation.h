// Where pixels saturate.
#pragma once

#include <cstddef>
#include <string>

#include "calibration/core/fit_result.h"
#include "calibration/tof/scenes.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

/// Full well from planes at known distances: pixels that have a range at one distance and none at a nearer
/// one had too much light there; how much follows from their amplitude and 1/R². The fullest tap of a pixel
/// holds A/|g|·(1/C + max(|g_x|, |g_y|)) electrons, g the model's phasor (its harmonics as they were fitted):
/// the well lies between the most that was still measured and the least that was not. Parameter
/// `full_well_e`, of uniform distribution between them, blurred by a tap's noise. Without such pixels it is
/// not identifiable, and the most that was measured is said.
[[nodiscard]] FitResult full_well(const TofScenes& scenes, const models::TofModel& model, double contrast);

}  // namespace rigor::calibration
