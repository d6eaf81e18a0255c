// Variances of ranges at known amplitudes, from one picture or from many.
//
// Spatial: in windows of n x n pixels a quadratic surface is fitted to the ranges; the sum of squares that it
// leaves over n² − 6 estimates the variance. What differs from pixel to pixel for good (fixed pattern) counts
// as noise here, and b of a law moves with n, as smoothing inside the camera shows in it: estimator and
// window belong to the numbers. Windows do not overlap, so that they are independent.
//
// Temporal: of each pixel over the frames of one scene at rest.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "calibration/tof/noise_law.h"
#include "calibration/tof/tof_frames.h"

namespace rigor::calibration {

struct SpatialNoiseOptions {
  int window_px = 7;  ///< odd, 5 to 31
  /// Windows where the amplitude varies by more than this factor hold an edge and are left out.
  double max_amplitude_ratio = 2;
  int bins = 24;
  std::size_t minimum_windows = 30;  ///< of a group
};

struct NoiseSample {
  double amplitude, deviation_m;
};
struct LocalNoise {
  std::vector<NoiseBin> bins;
  std::string estimator;             ///< in words
  std::vector<NoiseSample> samples;  ///< a share of the single deviations, for histograms; at most 20,000
  std::size_t windows = 0, edges = 0, saturated = 0;
};

/// Amplitude from which on pixels are saturated: where one value, the largest, is taken by more than a
/// thousandth of the pixels and by far more than the values below it; infinite where there is no such pile.
[[nodiscard]] double amplitude_ceiling(std::span<const TofFrame> frames);

/// bad_input: no amplitudes, or no window without gaps.
[[nodiscard]] Result<LocalNoise> spatial_noise(std::span<const TofFrame> frames,
                                               const SpatialNoiseOptions& options);

}  // namespace rigor::calibration
