// The wiggling error of the model, differentiable. Internal to calibration/tof.
#pragma once

#include <ceres/jet.h>

#include <cmath>
#include <vector>

#include "sensor-hal/models/tof/tof_math.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

/// Range that the model reports for a true one, less the true one: the phases' errors of all frequencies,
/// weighted as the simulator weights them (f²).
template <class T>
T wiggling_error(const std::vector<double>& turns_per_m, const T* harmonics, const T& range_m) {
  using Math = models::TofMath<T>;
  T sum(0);
  double weights = 0;
  for (const double t : turns_per_m) {
    const T turns = range_m * T(t);
    T x, y;
    Math::tof_phasor(turns, T(0), harmonics[0], harmonics[1], harmonics[2], harmonics[3], T(1), T(1), x, y);
    T error = Math::tof_angle_turns(x, y) - turns;
    using std::floor;
    error -= floor(error + T(0.5));
    sum += error * T(t);  // t² · error / t
    weights += t * t;
  }
  return sum / T(weights);
}

}  // namespace rigor::calibration
