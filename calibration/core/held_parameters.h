// Parameters that a fit held at their start are inputs of it and no result.
#pragma once

#include "calibration/core/fit_result.h"

namespace rigor::calibration {

/// Takes the held parameters, with their rows and columns of the covariance, out of the result.
void drop_held(FitResult& result);

}  // namespace rigor::calibration
