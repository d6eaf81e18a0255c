// The EMVA 1288 model of a sensor (sensor-hal/models/emva_noise.glsl.h) from levels of frames.
//
//   mean_dark(t)  = black + K D(T) t                      D(T) = D 2^((T − T_ref)/doubling)
//   mean_light    = black + μ                             μ free for each level: the response need not be
//                                                         linear for the photon transfer to be
//   variance      = K² σ_r² + 1/12 + K (mean − black)     the rounding itself below half a DN of noise
//   DSNU², PRNU²  from the mean pictures, high-passed, the temporal noise that is left taken out
//
// A response that bends, y = R(x) (response.h), is seen in the signal over exposure times; the levels are
// then taken back to x before the fit.
//
// One joint weighted fit; every datum carries the variance that its own statistics give it (χ² of the sample
// variance, skewness of the photons between mean and variance). Where the residuals are larger than that
// (a real sensor's), the covariance is scaled up and the fit says so.
//
// Sources: EMVA Standard 1288, release 4.0 Linear (2021), sections 2 to 4 and 6 to 8; Foi et al., IEEE Trans.
// Image Process. 17 (2008) 1737 for the Poissonian–Gaussian form.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/photon/exposure_pairs.h"
#include "calibration/photon/frame_stacks.h"
#include "calibration/photon/level_statistics.h"
#include "calibration/photon/response.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

struct PhotonFitOptions {
  std::string model = "auto";  ///< one_gain, two_gains, one_gain_bent
  int bits = 0;                ///< see StatisticsOptions
  int mosaic = -1;
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

struct LinearityPoint {
  double exposure_s = 0, signal_dn = 0, deviation = 0, sigma = 0;  ///< relative to the line
  int phase = 0;
};

struct PhotonFit {
  FitResult result;
  StackStatistics statistics;
  std::vector<bool> in_range;  ///< of each point: it counted
  /// Fitted temporal variance over the signal (mean − black), and its standard uncertainty.
  std::vector<double> curve_signal_dn, curve_variance_dn2, curve_sigma_dn2;
  double black_dn = 0;           ///< that `signal` is counted from
  std::vector<double> whitened;  ///< residuals of the variances in standard deviations
  std::vector<LinearityPoint> linearity;
  std::vector<PairBin> pairs;  ///< of single frames of a still scene; empty: there are levels of several
  std::optional<double> linearity_error;  ///< EMVA 1288 LE: mean absolute relative deviation
  std::optional<double> response_exponent, response_exponent_sigma;
  PhotonResponse response;  ///< of the model; linear unless `one_gain_bent`
  /// c2 of a response with that term alone, whether it was chosen or not; and the flicker of the light from
  /// level to level (relative) that the signal's scatter about the best response amounts to.
  std::optional<double> response_c2_seen, response_c2_seen_sigma, level_flicker;
  std::optional<double> saturation_signal_dn;  ///< where the temporal variance peaks, or the converter ends
  bool converter_saturates = false;            ///< before the pixel does
  double temperature_reference_c = 25;
};

/// bad_input: no level can be used at all, with what each of them is; else what the data do not say is in
/// `not_identifiable`. One thread.
[[nodiscard]] Result<PhotonFit> fit_photon(const FrameStacks& stacks, const PhotonFitOptions& options);

}  // namespace rigor::calibration
