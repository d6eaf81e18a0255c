// Fall-off of the light towards the corners of a picture (vignetting).
#pragma once

#include "calibration/procedures/photon_input.h"

namespace rigor {

struct ShadingCalibrationOptions : CalibrationInputs {
  PhotonInputOptions input;  ///< `dark`: pictures without light; exposures are not needed
  double black_dn = -1;      ///< black level where there are no dark pictures; below 0: that of the base
  bool mosaic = false;       ///< the pixels are a 2x2 mosaic of colours
};

/// `inputs`: pictures of an even light, folders or recordings of them; or one table of gains (.csv, .txt, or
/// a libcamera tuning file .json). `base` is needed: the fall-off counts from its principal point. `model`: a
/// shading model by its name. The sensor model is a camera's. Details: RMS in percent of the light on the
/// axis, the centre of the fall-off in pixels, quantiles beside those of the simulated twin. Errors:
/// not_found, bad_input (no base, other sizes than its, pictures that are saturated or of colour).
[[nodiscard]] Result<CalibrationResult> calibrate_shading(const ShadingCalibrationOptions& options,
                                                          const StopToken& stop = {});

}  // namespace rigor
