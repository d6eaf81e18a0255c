// What a sensor does over time while its target stands still.
//
//   y_k = c + d·t_k + x_k + g_k + e_k
//   e  white noise, σ `white_noise_m` a sample
//   x  random walk, `random_walk_m_per_sqrt_s`
//   g  correlated noise (first-order Gauss–Markov), `correlated_noise_m` with `correlation_time_s`
//   d  a straight drift, whose uncertainty counts x and g
//
// Maximum likelihood by a Kalman filter; c and d are solved for exactly. Models (white, correlated,
// random_walk, correlated+random_walk) are compared by BIC and by thirds of the series that are withheld: by
// the standard deviation that a normal distribution of the same predictive density has.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/tof/allan.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

struct DriftOptions {
  std::string model = "auto";
  double reject_sigmas = 6;  ///< of a sample against the median of its 31 neighbours
  int folds = 3;             ///< 0: no cross-validation
  std::string name{};        ///< of the series, for messages
  StopToken stop{};
};

struct DriftFit {
  FitResult result;
  double white_m = 0, random_walk = 0, correlated_m = 0, correlation_s = 0, mean_m = 0, drift_mps = 0;
  double period_s = 0;
  std::vector<double> series;      ///< what was fitted: gaps and outliers filled by their neighbours' mean
  std::vector<double> prediction;  ///< of the filter, one step ahead
  std::vector<double> innovation;  ///< in standard deviations; NaN where nothing was measured
  std::vector<AllanPoint> allan;
  double step_m = 0;  ///< all values are whole multiples of it; 0: of none
  /// Beyond this many samples averaging does not gain as 1/√n; 0: to the end of the recording it does.
  std::size_t averaging_limit = 0;
  double minimum_deviation_m = 0;  ///< of the Allan deviations
  double minimum_tau_s = 0;
};

/// A series at equal steps; NaN where nothing was measured. bad_input: fewer than 100 values, values that are
/// all the same, no such model.
[[nodiscard]] Result<DriftFit> fit_drift(std::span<const double> range_m, double period_s,
                                         const DriftOptions& options);

/// Allan deviation that the fitted noise has at τ (drift included).
[[nodiscard]] double model_allan(const DriftFit& fit, double tau_s);

}  // namespace rigor::calibration
