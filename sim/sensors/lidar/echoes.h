// From what the rays of a footprint meet to echoes, and from echoes to what the device says.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>

#include "sensor-hal/models/air/air_math.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "sensor-hal/models/philox.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::lidar {

using LidarMath = models::LidarMath<double>;
using AirMath = models::AirMath<double>;

/// Echoes that are kept of one firing; of more, the weakest between the first and the last go.
inline constexpr std::uint32_t kMaxEchoes = 8;

enum class EchoSource : std::uint8_t { surface, ghost, particle };

struct Echo {
  float range_m = 0;
  float remission = 0;        ///< E of lidar.glsl.h, air taken into account
  float cos_incidence = 1;    ///< mean by power; 1 where no surface sent it
  std::uint16_t sub_ray = 0;  ///< that gives it the most
  EchoSource source = EchoSource::surface;
};

/// What the air does to the beams of one scan, in their band.
struct AirState {
  struct Layer {
    double extinction_per_m, top_m;
  };
  std::array<Layer, 8> layers{};
  std::uint32_t layer_count = 0;
  double everywhere_per_m = 0;  ///< layers without a top, and precipitation

  double drops_per_m3 = 0, drop_diameter_m = 0;  ///< 0: no early returns from drops
  double drop_reach_m = 0;                       ///< farther none is detected
  double drops_within_reach = 0;                 ///< expected number in the beam
  double beam_divergence_rad = 0;
  float soft_range_m = 0, soft_remission = 0;  ///< fog's own echo; 0: none

  [[nodiscard]] bool clear() const { return layer_count == 0 && everywhere_per_m == 0; }
  /// For a ray from a height along a direction's upward part.
  [[nodiscard]] double two_way(double origin_z_m, double direction_z, double range_m) const {
    double depth = everywhere_per_m * range_m;
    for (std::uint32_t i = 0; i < layer_count; ++i)
      depth += layers[i].extinction_per_m *
               AirMath::air_way_below_m(origin_z_m, direction_z, range_m, layers[i].top_m);
    return AirMath::air_two_way_transmission(depth);
  }
};

/// Of the frame, for a model; `z_m`: the sensor's height. Setup of a scan.
[[nodiscard]] AirState air_state(const models::LidarModel& model, const render::ContentFrame& frame, int band,
                                 double z_m);

/// Received power but for a constant: what decides between echoes.
[[nodiscard]] inline double power(const models::LidarModel& m, double remission, double range_m) {
  return LidarMath::lidar_received_power(remission, range_m, 1.0, m.detection.overlap_m);
}

/// Echoes by range, put together where they are nearer than the separation.
class EchoList {
 public:
  [[nodiscard]] std::uint32_t count() const { return count_; }
  [[nodiscard]] const Echo& operator[](std::uint32_t i) const { return echoes_[i]; }
  [[nodiscard]] std::span<const Echo> all() const { return std::span(echoes_).first(count_); }
  void push_back(const Echo& e) {
    if (count_ == kMaxEchoes) drop_weakest();
    echoes_[count_++] = e;
  }
  /// In the order of range; nearer than the separation to another: one echo between them by power.
  void insert(const models::LidarModel& m, const Echo& e);

 private:
  void drop_weakest() {
    std::uint32_t weakest = 1;
    for (std::uint32_t i = 2; i + 1 < count_; ++i)
      if (echoes_[i].remission < echoes_[weakest].remission) weakest = i;
    std::copy(echoes_.begin() + weakest + 1, echoes_.begin() + count_, echoes_.begin() + weakest);
    --count_;
  }
  std::array<Echo, kMaxEchoes> echoes_{};
  std::uint32_t count_ = 0;
};

/// One ray's part of a footprint.
struct Return {
  float range_m;
  std::uint16_t sub_ray;
  double remission;
  float cos_incidence;
};

/// Remission of what a ray met, per unit of weight, in clear air.
[[nodiscard]] inline double surface_remission(const models::LidarModel& m, const render::Hit& hit) {
  return LidarMath::lidar_surface_remission(hit.cos_incidence, hit.reflectance, hit.metallic, hit.roughness,
                                            hit.retro_reflection, m.retro.gain);
}

/// Puts a footprint's returns together. Sorts them.
[[nodiscard]] EchoList form_echoes(const models::LidarModel& m, std::span<Return> returns);

}  // namespace rigor::lidar
