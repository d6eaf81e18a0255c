// A simulated LiDAR: scan pattern and error model (sensor-hal/models/lidar) over an engine's rays.
//
//   auto lidar = LidarSimulator::create({.name = "front", .model = *load_lidar_model(file), .seed = 1},
//   engine);
//   (*lidar)->capture({.index = 0, .t_capture = t}, {world, T_world_sensor}, points);
//
// Same request, world, pose function and spec: same points, on any number of threads.
#pragma once

#include <memory>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"
#include "sensor-hal/types/sample.h"
#include "sim/render/engine/ray_engine.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct LidarSpec {
  std::string name;  ///< keys the noise, with the seed
  models::LidarModel model;
  std::uint64_t seed = 0;
  bool ideal = false;            ///< one ray per beam, no errors
  double allowed_error_rad = 0;  ///< of the content that is asked for; 0: in full
};

class LidarSimulator {
 public:
  /// Errors: bad_input.
  [[nodiscard]] static Result<std::unique_ptr<LidarSimulator>> create(
      const LidarSpec& spec, std::shared_ptr<render::RayEngine> engine);
  ~LidarSimulator();
  /// One scan (2D: one sweep; 3D: one revolution). Points in the sensor's frame at the instant of their own
  /// firing (that of a device that does not know that it moves), in the order of firing; no return gives no
  /// point. Blocks.
  [[nodiscard]] Status capture(const MeasureRequest& request, const render::SensorView& view,
                               std::vector<LidarPoint>& points, GroundTruth* truth = nullptr);
  /// Most points of one scan.
  [[nodiscard]] std::size_t max_points() const;
  [[nodiscard]] const LidarSpec& spec() const;

 private:
  struct Impl;
  explicit LidarSimulator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
