// What has changed between a time-of-flight camera and its simulated side, from range images of the same
// instants.
//
// Residual real − simulated of the range of a pixel where both have a return and the simulated side sees no
// edge:
//
//   offset               1                    m
//   range scale          range                relative; in products the mean of the four pixels beside,
//                                             whose noise is not in the residual
//   low, high amplitude  1 below a third, above two thirds of amplitude_max: m, against the middle third
//   amplitude            simulated amplitude  relative, in a fit of its own
//
// Where all pixels are of one third (a far wall), what they have in common is the offset.
//
// Noise of a range is told by its amplitude A: sigma(A) = sigma_m (amplitude_max / 2A)^noise_exponent, 1/2
// where the noise is that of the light. Pixels weigh by it; far walls would drown the rest else.
//
// The parameter noise is what second differences along a row leave of the residuals: its variance over
// sigma², as excess of the real side if the simulated side's noise is sigma; over all, and by amplitude
// (thirds) against that. `flying`: the share of pixels that lie between two neighbours of a row that are an
// edge apart, and off both; real less simulated. `lost`: pixels that the simulated side alone returns,
// `gained`: the real side alone, as shares of those that either returns.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/pair_watch/noise_sums.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"
#include "sensor-hal/types/sample.h"

namespace rigor::pair_watch {

struct RangeImageChangeOptions {
  double sigma_m = 0.02;      ///< of one range at half of amplitude_max, by the sensor model
  double amplitude_max = 1;   ///< in the device's own unit
  double noise_exponent = 0;  ///< 0: the same at any amplitude
  double edge_m = 0.2;        ///< neighbours farther apart than this are an edge
};

class RangeImageChange {
 public:
  /// Setup. bad_input: options that are not above 0, a picture of less than 8×8 pixels.
  [[nodiscard]] static Result<RangeImageChange> make(const RangeImageInfo& shape,
                                                     const RangeImageChangeOptions& options);
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return parameters_; }

  // One thread at a time; no allocation.
  /// False: not range images of the shape, or one is incomplete; nothing has happened. Without an amplitude
  /// plane every pixel is of middle amplitude.
  bool add(const Sample& real, const Sample& simulated) noexcept;
  void finish(Estimate& estimate) noexcept;

 private:
  RangeImageChange(const RangeImageInfo& shape, const RangeImageChangeOptions& options);
  [[nodiscard]] double variance_at(double amplitude) const noexcept;

  RangeImageInfo shape_;
  RangeImageChangeOptions options_;
  std::vector<Parameter> parameters_;
  WindowFit window_, amplitude_;
  NoiseSums noise_sums_;
  double weights_ = 0;  ///< of the window's pixels
  double both_ = 0, lost_ = 0, gained_ = 0, flying_[2] = {0, 0}, looked_at_ = 0;
};

}  // namespace rigor::pair_watch
