// A pair of time-of-flight cameras: offset and scale of the range, gain of the amplitude, noise.
//
//   ρ_real = (1 + s) ρ_sim + o      at pixels where the simulated side sees no edge; Huber's weights
//   A_real = g A_sim                a ratio of sums
//
// Noise of both sides by second differences along a row, by amplitude. A phase's variance is, with B
// electrons of light of one tap that are not its signal (dark, ambient, read noise squared) and contrast C,
//
//   σ² = κ (2A/C + B)/A² + P
//
// with P that of a pattern of offsets. κ, B and P of the simulated side come from its own samples, B of the
// device with the amplitude g A; what B has grown by is read noise squared.
#pragma once

#include "calibration/pair/pair_model.h"

namespace rigor::calibration {

struct RangePairOptions : PairOptions {
  double sigma_m = 0.02;  ///< of one range, roughly
  double edge_m = 0.2;    ///< neighbours farther apart than this are an edge
  bool scale = true;
};

struct RangePairFit : PairFit {
  double offset_m = 0, scale = 0;
  double amplitude_gain = 1;
  bool amplitudes = false;  ///< the device tells them
  double lost = 0, gained = 0;
};
/// bad_input: no pairs, range images that cannot be compared.
[[nodiscard]] Result<RangePairFit> fit_range_pair(const ForEachPair& pairs, const RangePairOptions& options);

struct RangeNoiseFit {
  bool solved = false;               ///< false: fewer than four levels, or a law that does not fit
  double more_e2 = 0, sigma_e2 = 0;  ///< B of the device less that of the simulated side, electrons²
  double kappa = 0, background = 0;  ///< of the simulated side
  double chi2 = 0;
  int levels = 0;
};
/// Levels' `level` is the simulated side's amplitude in electrons.
[[nodiscard]] RangeNoiseFit fit_range_noise(const RangePairFit& fit, double contrast);

}  // namespace rigor::calibration
