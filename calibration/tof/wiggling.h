// The wiggling error of the model, differentiable. Internal to calibration/tof.
#pragma once

#include <ceres/jet.h>

#include <array>
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

/// Uniform cubic B-spline over [from, to] with `count` coefficients (4 or more).
struct Spline {
  double from = 0, to = 1;
  int count = 4;
  /// Values of the four that are not 0 at x, and the index of the first; slopes.
  int basis(double x, std::array<double, 4>& value, std::array<double, 4>& slope) const {
    const int pieces = count - 3;
    const double h = (to - from) / pieces;
    double t = (x - from) / h;
    int i = static_cast<int>(std::floor(t));
    i = i < 0 ? 0 : i >= pieces ? pieces - 1 : i;
    t -= i;  // beyond the ends the last piece goes on
    const double t2 = t * t, t3 = t2 * t;
    value = {(1 - 3 * t + 3 * t2 - t3) / 6, (4 - 6 * t2 + 3 * t3) / 6, (1 + 3 * t + 3 * t2 - 3 * t3) / 6,
             t3 / 6};
    slope = {(-1 + 2 * t - t2) / 2 / h, (-4 * t + 3 * t2) / 2 / h, (1 + 2 * t - 3 * t2) / 2 / h, t2 / 2 / h};
    return i;
  }
};

}  // namespace rigor::calibration
