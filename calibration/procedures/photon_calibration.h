// Gain, noise and saturation of an image sensor, by EMVA 1288.
#pragma once

#include "calibration/procedures/photon_input.h"

namespace rigor {

struct PhotonCalibrationOptions : CalibrationInputs {
  PhotonInputOptions input;
  int bits = 0;         ///< of the converter; 0: from the pictures
  bool mosaic = false;  ///< the pixels are a 2x2 mosaic of colours
  bool grey = false;    ///< they are none, though they differ
  /// Makes a sensor model, for which `base` is then needed: a photon transfer knows neither lens nor size.
  bool sensor_model = true;
};

/// `inputs`: see read_photon_pictures(). Parameters in DN, electrons and seconds; the sensor model is a
/// camera's. Details: `adc_bits`, `levels`, `snr_max`, `dynamic_range_db` and what else the data say. Errors:
/// not_found, bad_input (no base, no exposure, colour, too few levels).
[[nodiscard]] Result<CalibrationResult> calibrate_photon(const PhotonCalibrationOptions& options,
                                                         const StopToken& stop = {});

}  // namespace rigor
