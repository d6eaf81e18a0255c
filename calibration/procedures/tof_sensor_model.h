// How a calibrated time-of-flight camera becomes a sensor model.
#pragma once

#include "calibration/camera/camera_fit.h"
#include "calibration/core/fit_output.h"
#include "calibration/tof/range_fit.h"

namespace rigor {

struct TofModelParts {
  const calibration::RangeFit* ranges = nullptr;  ///< null: no planes at known distances
  const calibration::CameraFit* lens = nullptr;   ///< null: the base's
  double electrons_per_amplitude = 1;             ///< NaN: the amplitude's unit is not known in electrons
};
/// Keys of the sensor model and which parameter each stands for: what has a finite uncertainty. Wiggling,
/// offset and error of the amplitude replace the base's together, as they were fitted without it.
void set_tof_model(calibration::SensorModelRecipe& recipe, const calibration::FitResult& fit,
                   const TofModelParts& parts);

}  // namespace rigor
