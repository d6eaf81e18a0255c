// Noise of single shots against remission, in the simulator's own model (lidar.glsl.h: lidar_range_sigma_m)
// of at most four parameters.
//
// Shots of one beam at (nearly) one azimuth form a cell; what is left of them after a mean, a slope or, in a
// single scan, a parabola over azimuth is noise, wherever the light fell: no wall is needed. Cells at edges
// and of things that moved are left out (noise_cells.h). The variances of the rest, each with its degrees of
// freedom and with what rounding adds (rounded_values.h), are fitted by their likelihood (gamma), smallest
// model first; a band of remission at a time is withheld and predicted.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/lidar/lidar_returns.h"
#include "rt-core/result.h"

namespace rigor::calibration {

struct NoiseCell {
  double remission = 0;  ///< E, mean
  double units = 0;      ///< what the device called it
  double range_m = 0;
  double variance_m2 = 0;
  double units_variance = 0;  ///< of what it called it
  double dof = 0;
  bool used = true;
};

struct NoiseBand {
  double from = 0, to = 0;  ///< E
  double measured_m = 0;    ///< sigma, rounding taken out
  double sigma_m = 0;       ///< standard uncertainty of it
  double model_m = 0;       ///< by the chosen model
  double withheld_m = 0;    ///< by the chosen model fitted to the other bands
  double shots = 0;
};

struct NoiseModel {
  double floor_m = 0, scale_m = 0, offset = 0, exponent = 1;
  [[nodiscard]] double sigma_m(double remission) const;
};

struct NoiseFit {
  /// `noise_floor_m`, `noise_scale_m`, `noise_offset`, `noise_exponent`; those that the model has not are
  /// held. `retro_sigma_m` where enough came from remission above 1. Residuals: of single shots [m].
  FitResult result;
  NoiseModel model;
  std::vector<NoiseCell> cells;
  std::vector<NoiseBand> bands;
  double sigma_m = 0;  ///< of all shots that were used, rounding taken out
  double rounded_sigma_m =
      0;  ///< by the likelihood of the rounded values, where every beam stood still; else 0
  double rounded_sigma_uncertainty_m = 0;
  double largest_share = 0;  ///< of the shots whose remission is the largest that was told
  double largest_units = 0;
  double withheld_error = 0;           ///< RMS over bands of measured/predicted − 1
  std::vector<float> shot_residual_m;  ///< of each return; NaN: not used
};

struct NoiseFitOptions {
  std::string model = "auto";  ///< constant, photon, photon+floor, power, offset, offset+floor, full
  int bands = 6;
};

/// bad_input: no cells with shots to compare (one scan of few shots, or nothing that held still).
[[nodiscard]] Result<NoiseFit> fit_range_noise(const LidarReturns& returns,
                                               const models::LidarModel& sensor_model,
                                               const NoiseFitOptions& options = {});

}  // namespace rigor::calibration
