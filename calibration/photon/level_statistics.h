// From stacks of frames to the numbers that photon transfer works with: for each level and each place of the
// mosaic the mean, the temporal variance and their uncertainty; which pixels and levels are left out and why;
// and the fixed patterns of the dark and of the light.
#pragma once

#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/photon/frame_stacks.h"

namespace rigor::calibration {

/// One level at one place of the mosaic (`phase` 0 … 3; 0 for grey sensors). In converter steps (DN).
struct LevelPoint {
  std::size_t level = 0;
  int phase = 0;
  int frames = 0;
  double pixels = 0;  ///< that were used
  double mean_dn = 0;
  double variance_dn2 = 0;  ///< over time, the flicker of the light taken out; NaN for a single frame
  double fourth_dn4 = 0;    ///< σ⁴ averaged over the pixels: what the variance of the variance is made of
  double flicker_dn2 = 0;   ///< variance of the frames' means: the light's, and of all pixels alike
  double pixel_variance_dn2 = 0;  ///< of the pixels' means, temporal noise taken out
  double black_share = 0;         ///< of pixels that were at 0 at least once
  double white_share = 0;         ///< the same at the largest value that there is
  bool usable = true;             ///< neither clipped nor alone
  std::string why;                ///< it is not usable
};

/// A standard deviation over pixels squared, with its uncertainty.
struct PatternVariance {
  double value = 0, sigma = 0;  ///< value may be negative: less than the noise explains
  double pixels = 0;
  bool valid = false;
};

/// Of a fixed pattern: variances of the offsets of rows, of columns, and of the pixels apart from both.
struct PatternSplit {
  PatternVariance row, column, pixel;
  /// Rows or columns are there beyond chance.
  [[nodiscard]] bool striped() const {
    return (row.valid && row.value > 4 * row.sigma) || (column.valid && column.value > 4 * column.sigma);
  }
};

struct OutlierPixels {
  std::vector<bool> bad;  ///< of each pixel
  std::size_t count = 0;
  /// What they have more than the median pixel, per second of exposure, for those that are hot.
  std::vector<double> hot_dn_per_s;
  std::size_t hot_full = 0;       ///< of those: too hot to see how hot
  double hot_limit_dn_per_s = 0;  ///< hotter ones are found; 0: the dark frames do not say
  std::vector<Rejected> named;    ///< the worst first
};

struct StackStatistics {
  int bits = 8;
  int max_dn = 255;
  int step = 1;  ///< that the values were divided by
  bool mosaic = false;
  std::vector<LevelPoint> points;
  OutlierPixels outliers;
  PatternVariance dark_pattern_dn2;  ///< DSNU², in DN²
  PatternVariance light_pattern;     ///< PRNU², relative
  PatternSplit dark_split_dn2, light_split;
  std::vector<std::string> warnings;
};

struct StatisticsOptions {
  int bits = 0;     ///< of the converter; 0: from the largest value
  int mosaic = -1;  ///< 1: colours in a 2x2 mosaic, 0: grey, −1: looked for
};

[[nodiscard]] StackStatistics stack_statistics(const FrameStacks& stacks, const StatisticsOptions& options);
/// Pairs of usable levels whose temporal noise is the same pixel by pixel (correlation above 0.3), as `A and
/// B`: no sensor's is; recordings of simulated ones are, where two runs have one seed and the same instants.
[[nodiscard]] std::vector<std::string> repeated_noise(const FrameStacks& stacks,
                                                      const StackStatistics& statistics);
/// Fixed patterns, once it is known which levels are within the range (`in_range` of each point).
void fixed_patterns(const FrameStacks& stacks, const std::vector<bool>& in_range,
                    StackStatistics& statistics);

}  // namespace rigor::calibration
