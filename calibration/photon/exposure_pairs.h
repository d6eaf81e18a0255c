// The gain of a sensor from single frames of a still scene at several exposure times.
//
// Two frames A (t₁) and B (t₂ = r t₁) of one pixel differ by what the scene's light is multiplied by, and by
// noise. Of z = A + B and B the first says how bright the pixel is, the second, for a given z, is noise
// alone:
//
//   var(B | z) = (var_B + r² var_A)/(1 + r)² = K r z/(1 + r)² + S (1 + r²)/(1 + r)²
//
// with var = K signal + S. (For Poisson noise z is sufficient for the brightness; binning by A or by B
// instead would bias the result, regression dilution.) Pixels on edges are left out, as are clipped ones. S
// mixes read noise, rounding and the unknown black level: it is solved for and not reported.
#pragma once

#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/photon/frame_stacks.h"
#include "calibration/photon/level_statistics.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

struct PairBin {
  std::string pair;  ///< `25 ms and 50 ms`
  int set = 0;       ///< number of the pair and colour
  double first_s = 0, second_s = 0;
  double first_dn = 0, second_dn = 0;  ///< means of the bin
  double variance_dn2 = 0;             ///< of B about its mean for a given z
  double pixels = 0;
  double expected_dn2 = 0;             ///< by the fit
  std::vector<float> deviations_dn{};  ///< of B from what z says, those that were used
};

struct ExposurePairs {
  FitResult result;  ///< system_gain_dn_per_e, or why not
  std::vector<PairBin> bins;
};

/// Scatter of each pair of exposures that follow each other, over brightness; `expected_dn2` is not filled.
[[nodiscard]] std::vector<PairBin> pair_bins(const FrameStacks& stacks, const StackStatistics& statistics);

/// `statistics` of the same stacks. bad_input: fewer than two exposures of light.
[[nodiscard]] Result<ExposurePairs> fit_exposure_pairs(const FrameStacks& stacks,
                                                       const StackStatistics& statistics,
                                                       const StopToken& stop);

}  // namespace rigor::calibration
