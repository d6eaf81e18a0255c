// What the rays of a time-of-flight camera met, and what of it comes back at another instant: in which part
// of the picture, from how far, how bright. Internal to sim/sensors/tof.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor-hal/models/tof/tof_model.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::tof {

/// Met points as arrays, so that loops over them become vector instructions.
class Returns {
 public:
  void resize(std::size_t count) {
    for (auto* v : {&x_, &y_, &z_, &met_, &nx_, &ny_, &nz_, &diffuse_, &retro_, &alpha2_, &f0_})
      v->resize(count);
  }
  [[nodiscard]] std::size_t count() const { return x_.size(); }
  void set(std::size_t i, const render::Ray& ray, const render::Hit& hit, double retro_gain);

  /// As a sensor sees them. Arrays of count(), of which those from `first` on are worked out.
  struct Seen {
    std::vector<float> u_px, v_px;    ///< from the picture's upper left corner; NaN: not seen
    std::vector<float> range_m;       ///< 1 where nothing was met
    std::vector<float> remission;     ///< of surfaces; 0 where nothing was met
    std::vector<float> off_axis_cos;  ///< of the angle to the optical axis
    std::vector<float> rise;          ///< z of the direction in world axes
  };
  void see(const models::TofModel& model, const Eigen::Matrix3f& R_sensor_world, const Eigen::Vector3f& eye,
           std::size_t first, Seen& seen) const;

 private:
  std::vector<float> x_, y_, z_, met_;  ///< point; of rays that met nothing their direction, and met 0
  std::vector<float> nx_, ny_, nz_;
  std::vector<float> diffuse_, retro_, alpha2_, f0_;
};

}  // namespace rigor::tof
