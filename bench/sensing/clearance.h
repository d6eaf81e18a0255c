// How near things stand to a point of the world: whether a sensor that is put there would be inside a trunk
// or against a wall.
//
//   auto probe = simulation.clearance_probe();
//   auto near = (*probe)->nearest(motion, p_world, 0.5, "robot");   // empty: nothing within half a metre
//
// Rays go out of the point all round, and come in from a sphere around it, because from inside a hull one
// sees out. The ground and what grows on it (Terrain, GroundPlane, GroundVegetation, Road, Water) do not
// count, nor does a platform that carries the sensor.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bench/sensing/sensor_world.h"
#include "sim/render/rays/embree_engine.h"

namespace rigor {

class ClearanceProbe {
 public:
  /// The world outlives the probe. Errors: unavailable (the engine).
  [[nodiscard]] static Result<std::unique_ptr<ClearanceProbe>> create(
      SensorWorld& world, const std::shared_ptr<render::EmbreeCache>& cache);

  struct Obstacle {
    double range_m = 0;  ///< from the point; 0: the point is inside it
    world::NodeId node{};
    std::string type;
  };
  /// The nearest thing within `radius_m` (up to kReach_m) of the point, by kRays directions: what is thinner
  /// than their gaps may be missed. `carrier`: a platform that does not count; may be empty. Blocks for
  /// milliseconds; one thread at a time.
  [[nodiscard]] Result<std::optional<Obstacle>> nearest(const WorldMotion& motion,
                                                        const Eigen::Vector3d& p_world, double radius_m,
                                                        std::string_view carrier);

  static constexpr double kReach_m = 2;
  static constexpr int kRays = 256;

 private:
  explicit ClearanceProbe(SensorWorld& world);
  SensorWorld& world_;
  std::shared_ptr<render::EmbreeEngine> engine_;
  std::vector<render::Ray> out_, in_;
};

}  // namespace rigor
