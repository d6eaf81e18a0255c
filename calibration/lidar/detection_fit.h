// The least remission that a LiDAR sees, from where its returns set in.
//
// A floor, and a least received power: the remission needed grows with the square of range
// (lidar.glsl.h: lidar_least_remission). Near, the returns of remission E set in at the floor; far, those of
// E·(limit_range/range)² at `limit_remission`. Either, both or none is seen as an edge that is as sharp as
// the noise of the remission allows, among returns of many ranges.
#pragma once

#include <optional>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"

namespace rigor::calibration {

struct DetectionEdge {
  double at = 0, sigma = 0;
  bool sharp = false;  ///< false: `at` is only what it is at most
  double gain = 0;     ///< log likelihood over that of values that run out by themselves
};
/// Where returns set in: the least of `values` for a threshold that is blurred by the noise of what the
/// device tells, `blur` there; `step` that of rounding. Nothing: too few values.
[[nodiscard]] std::optional<DetectionEdge> detection_edge(std::vector<double> values, double blur,
                                                          double step);

struct DetectionFit {
  std::optional<DetectionEdge> floor, limit;  ///< those that are sharp
  double limit_range_m = 0;                   ///< where `limit` is the least remission
  double lowest = 0;                          ///< what the floor is at most
  double farthest_m = 0;
};
/// Of each return its remission E and range; `relative` noise of E and its `unit`. The limit is told at the
/// sensor model's limit_range_m, or at 10 m. Any thread.
[[nodiscard]] DetectionFit fit_detection(const std::vector<double>& remission,
                                         const std::vector<double>& range_m, double relative, double unit,
                                         const models::LidarDetection& sensor_model);

}  // namespace rigor::calibration
