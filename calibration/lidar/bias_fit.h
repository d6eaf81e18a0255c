// Systematic errors of the ranges and the angles of a LiDAR's beams, from planes.
//
// Two steps. First every return takes part: the richest model is fitted robustly (Cauchy), returns beyond
// `reject_sigmas` of the noise at their remission are left out. Then returns of a wall by one beam within a
// degree of azimuth become a cell with its mean residual; all models are compared on cells. A cell's variance
// is σ²/n of the shots plus τ², what a wall's own unevenness and repeated scans of the same spot share (by
// the Paule–Mandel equation, one τ for each wall). Cells that err alike widen the covariance, neighbours of a
// beam and all beams' at one azimuth (boards, ribs and bulges that run up a wall and along it:
// column_correlation.h), which widen what all beams share more than what they differ by. So a longer
// recording of the same spot does not make anything surer than the wall allows.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/lidar/plane_search.h"
#include "calibration/lidar/range_equation.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

/// Which errors are fitted. Planes that were found are fitted with each.
struct BiasModel {
  std::string name;
  bool offset = false;  ///< one bias for all beams
  bool beams = false;   ///< a bias for each beam
  bool angles =
      false;  ///< elevation and azimuth of each beam; the azimuth of beam 0 stays the sensor model's
  bool walk = false, oblique = false;
  bool scale = false;  ///< with surveyed planes alone: planes that are found scale with the ranges
};
/// none, offset, beams, beams+walk, beams+oblique, beams+angles, beams+angles+walk, all; of one beam those
/// without beams and angles; `surveyed` adds +scale.
[[nodiscard]] std::vector<BiasModel> bias_models(std::size_t beams, bool flat, bool surveyed);

struct BiasFitOptions {
  std::vector<BiasModel> models;  ///< empty: all, and the data choose
  bool surveyed = false;          ///< the planes are held
  double reject_sigmas = 4;
  double cell_rad = 0.0174532925199433;
  int folds = 5;
  double sector_rad = 0.174532925199433;  ///< of azimuth: what is withheld together
  /// Noise of one shot at remission E; empty: one number for all, from the residuals.
  std::function<double(double)> sigma_m{};
  /// Noise of one shot's remission at E: what `remission_bias_m` would be too small by. Empty: none.
  std::function<double(double)> remission_sigma{};
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

/// One wall by one beam within a cell of azimuth.
struct BiasCell {
  std::uint16_t beam = 0;
  std::uint8_t plane = 0;
  std::uint8_t fold = 0;
  std::int32_t sector = 0;
  double azimuth_rad = 0, remission = 0;
  double remission_variance = 0;  ///< of the mean, by the device's noise
  double count = 0;
  double range_m = 0;           ///< at `azimuth_rad`: the model's there and the mean residual
  double square_m2 = 0;         ///< sum of squares about the mean
  double shot_variance_m2 = 0;  ///< of the mean by noise
  bool used = true;
};

struct BiasFit {
  /// Parameters by name: `beam_bias_m[i]` (`range_bias_m` for one bias of all), `beam_elevation_rad[i]`,
  /// `beam_azimuth_rad[i]` (both as the sensor model states them), `remission_bias_m`, `incidence_bias_m`,
  /// `range_scale`. Residuals are those of single returns that were used.
  FitResult result;
  BiasModel model;
  std::vector<BeamErrors> errors;  ///< of each beam
  std::vector<LidarPlane> planes;
  std::vector<float> residual_m;   ///< of each return against the model; NaN: of no plane
  std::vector<std::uint8_t> used;  ///< of each return
  std::vector<BiasCell> cells;
  std::vector<double> plane_sigma_m;  ///< τ of each wall
  double neighbour_correlation = 0;   ///< of neighbouring cells of a beam
  double column_correlation = 0;      ///< of all beams' cells at one azimuth of a wall
  /// Residuals of sectors that were withheld, RMS of single returns: the chosen model over no errors at all.
  double held_out_rms_m = 0, held_out_uncorrected_m = 0;
  bool common_bias_free = false;    ///< biases are then against their mean
  double beams_differ_sigma_m = 0;  ///< of a bias against the mean of all beams
};

/// bad_input: too few returns on planes.
[[nodiscard]] Result<BiasFit> fit_biases(const LidarReturns& returns, const models::LidarModel& sensor_model,
                                         const PlaneSearch& planes, const BiasFitOptions& options);

}  // namespace rigor::calibration
