// By how much one channel's clock is off against another's, from a quantity that both saw move: an angle, a
// distance, a register.
//
//   second(t) = offset + gain · first(t + delay),        delay > 0: the second's stamps are early
//
// The first is followed by a cubic spline, so it should be the denser one. Both may be noisy: the noise of
// the first is estimated from its own samples, and neither makes the gain too small nor the standard
// uncertainties. Where nothing moves, or in a straight line (a shift in time is then a shift in value), the
// delay cannot be told: it is named, never reported as a number.
#pragma once

#include <cstdint>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"

namespace rigor::calibration {

struct TimeSeries {
  std::vector<std::int64_t> t_ns;  ///< increasing
  std::vector<double> value;
};

struct TimeOffsetOptions {
  double largest_s = 0.5;      ///< the search goes this far to both sides
  bool same_quantity = false;  ///< gain is 1 and offset 0: both measure the same in the same unit
  bool first_exact = false;    ///< the first has no noise and may jump: commands
  double reject_sigmas = 4;
};

struct TimeOffset {
  FitResult result;              ///< delay_s, and unless the same quantity: gain, offset
  double first_sigma = 0;        ///< standard deviation of the first channel's noise, in its unit
  std::vector<double> residual;  ///< of each sample of the second that was compared
  std::vector<std::int64_t> residual_t_ns;
};

/// bad_input: fewer than 8 samples in common, times that do not increase, numbers that are not finite. One
/// thread.
[[nodiscard]] Result<TimeOffset> fit_time_offset(const TimeSeries& first, const TimeSeries& second,
                                                 const TimeOffsetOptions& options = {});

}  // namespace rigor::calibration
