// Systematic errors of a time-of-flight camera from pictures of a plane at known distances.
//
//   range(s, p) = R + w(R) + k/A + o + δ_p + noise,   R = (D_s + e_s) / (u_z + a_s·u_x + b_s·u_y)
//
//   R      from the model's rays u and the plane: D_s as it was surveyed along the axis, e_s its error of
//          standard deviation `distance_sigma_m` (given, or estimated from how the scenes scatter), a_s and
//          b_s the plane's tilt, fitted
//   w      wiggling: the phase error of the model's correlation with harmonics 3, 5, 7, 9 (tof.glsl.h, over
//          ceres::Jet), or, for comparison, a cubic B-spline of the range
//          (to first order 3 and 5 make the same error, a5 − a3 times sin 4φ, and so do 7 and 9: a fit of
//          both knows their difference far better than either)
//   k/A    error that goes with the amplitude
//   o, δ_p offset of the camera and of each pixel: every pixel's own, nothing is assumed about their pattern
//
// so that pixels tell w only by how they change from scene to scene: pictures at one distance leave harmonics
// and offsets exactly free of each other, and that is said. Gauss–Newton over all samples with the pixels
// eliminated (they meet no one else: a rank-one step each), Cauchy weights until the scale stays, then
// samples beyond `reject_sigmas` are named and left out. The scenes' e_s are random effects: their variance
// by restricted maximum likelihood (MacKay's iteration), and Student's t where few scenes give it.
#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/tof/noise_law.h"
#include "calibration/tof/scenes.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

/// `none`, `harmonics1` … `harmonics4` (how many of 3, 5, 7, 9), `bspline`; `+amplitude` adds k.
struct RangeModel {
  int harmonics = 0;
  bool spline = false, amplitude = false;
  [[nodiscard]] std::string name() const;
  bool operator==(const RangeModel&) const = default;
};
/// bad_input with the names that there are.
[[nodiscard]] Result<RangeModel> parse_range_model(const std::string& name);

struct RangeFitOptions {
  std::vector<RangeModel> models{};  ///< compared; empty: all that the number of scenes allows
  double distance_sigma_m = -1;      ///< of one D_s; negative: not known
  double reject_sigmas = 5;          ///< a million samples hold thousands beyond 3, one beyond 5
  int folds = 5;                     ///< of scenes, for the cross-validation; 0: none
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

struct SceneFit {
  std::string name;
  double distance_m = 0;
  double error_m = 0, error_sigma_m = 0;  ///< e_s
  double tilt_x = 0, tilt_y = 0;          ///< a_s, b_s
  double range_m = 0;                     ///< mean over the picture
  double deviation_m = 0;  ///< mean of measured − R − o − δ_p with e_s = 0: what w should be
  double rms_m = 0;
  std::size_t samples = 0, rejected = 0, wrapped = 0;
  bool used = true;
};

struct RangeFit {
  FitResult result;
  RangeModel model;
  std::array<double, 4> harmonics{};
  double offset_m = 0, amplitude_error = 0, pattern_sigma_m = 0;
  /// Of the model `bspline`: its first coefficient is 0, the offset has the level.
  models::TofRangeError::Spline spline{};
  double distance_sigma_m = 0;
  bool distance_sigma_estimated = false;
  std::vector<float> pixel_offset_m;  ///< δ_p; NaN: the pixel had no range
  std::vector<SceneFit> scenes;
  /// w over the ranges that were seen, with its standard uncertainty up to a constant (an offset).
  struct CurvePoint {
    double range_m, error_m, sigma_m;
  };
  std::vector<CurvePoint> curve;
  std::vector<NoiseSample> samples;  ///< a share of the residuals with their amplitudes
  std::size_t wrapped = 0;
};

/// `noise` gives the weights (amplitudes known); without it all samples weigh the same. bad_input: no scene
/// with a known distance, a size other than the model's, no such model.
[[nodiscard]] Result<RangeFit> fit_ranges(const TofScenes& scenes, const models::TofModel& model,
                                          const NoiseCoefficients* noise, const RangeFitOptions& options);

}  // namespace rigor::calibration
