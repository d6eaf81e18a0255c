// A recording beside its simulated twin: the figures that all kinds of sensors share.
#pragma once

#include <string>
#include <vector>

#include "calibration/core/figures.h"

namespace rigor::calibration {

/// What is shown of both, in one unit.
struct TwinValues {
  std::string what;  ///< `dark 20 ms`
  std::string unit;
  std::vector<double> real, twin;
};

/// Histogram of the recording with the twin's counts as a curve over it, in bars of the same width. `step`:
/// of a converter, bars are then that wide; 0: none.
[[nodiscard]] Figure twin_histogram(const TwinValues& values, double step = 0);
/// Quantiles of the recording over those of the twin: on the line both are alike.
[[nodiscard]] Figure twin_quantiles(const std::vector<TwinValues>& values);

}  // namespace rigor::calibration
