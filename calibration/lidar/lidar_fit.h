// A LiDAR from one recording: noise, walls, biases, remission; each by its own part, here put together as one
// result and as the sensor model that a simulated channel reads.
#pragma once

#include <optional>

#include "calibration/lidar/remission_fit.h"

namespace rigor::calibration {

struct LidarFitOptions {
  std::string model = "auto";             ///< of biases: a name of bias_models()
  std::string noise_model = "auto";       ///< a name of fit_range_noise()
  std::vector<LidarPlane> surveyed = {};  ///< walls in the sensor's frame; empty: found in the data
  PlaneSearchOptions search{};
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

struct LidarFit {
  FitResult result;          ///< all parameters; residuals are those of the ranges [m]
  models::LidarModel model;  ///< the sensor model with what was fitted in it
  std::optional<NoiseFit> noise;
  std::optional<BiasFit> bias;
  PlaneSearch planes;
  /// Noise of single shots of the device and, draw by draw at the same remissions, of its twin: both about
  /// their cell's mean.
  std::vector<double> shots_m, twin_m;
  /// Residuals on the walls of the device and of its twin, return by return where the fitted model meets the
  /// fitted walls: what the device's have more is the walls' own.
  std::vector<double> walls_m, walls_twin_m;
};

/// bad_input: neither walls nor repeated shots; an unknown model. One thread; 1 M returns within seconds.
[[nodiscard]] Result<LidarFit> fit_lidar(const LidarReturns& returns, const models::LidarModel& sensor_model,
                                         const LidarFitOptions& options = {});

}  // namespace rigor::calibration
