// A pair of channels of numbers (registers, decoded signals, inertial units): of each number
//
//   y(t) = (1 + s) x(t − d) + b + noise
//
// Each pass carries the simulated side's x over (cubic interpolation at t − d) and takes the mean of the
// windows' estimates of pair_watch's ValueChange; their scatter is the covariance.
#pragma once

#include <string>
#include <vector>

#include "calibration/pair/pair_model.h"

namespace rigor::calibration {

struct ValueSeries {
  std::string name, unit;
  std::vector<double> t_s, real, simulated;  ///< of the same instants, in order of time
};

struct ValueFit {
  std::string name, unit;
  double bias = 0, scale = 0, delay_s = 0;                    ///< of the device over the simulated side
  double bias_sigma = 0, scale_sigma = 0, delay_sigma_s = 0;  ///< infinite: not determined
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();       ///< of bias, scale, delay; as far as determined
  double noise_real = 0, noise_simulated = 0;                 ///< standard deviations by second differences
  double noise_ratio = 1, noise_ratio_sigma = 0;              ///< of the two; 0: neither has any
  double one_step_delay_s = 0;
  int windows = 0, passes = 0;
  ResidualSample before, after;
};

/// bad_input: fewer than 64 instants, times that do not increase.
[[nodiscard]] Result<ValueFit> fit_value_pair(const ValueSeries& series, int most_passes = 12);

}  // namespace rigor::calibration
