// What a LiDAR measured, without its guess of where that lies: beam, azimuth of the rotor, range, remission.
// The pose of each beam comes from a sensor model (sensor-hal/models/lidar/lidar_model.h) and is itself
// fitted.
#pragma once

#include <cstdint>
#include <span>
#include <unordered_set>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"
#include "sensor-hal/types/sample.h"

namespace rigor::calibration {

struct LidarReturn {
  float range_m = 0;      ///< along the beam from its origin, as the device said
  float remission = 0;    ///< device's unit; NaN: not told
  float azimuth_rad = 0;  ///< of the rotor; the beam's own comes on top. Anticlockwise, x forward, −π … π
  std::uint16_t beam = 0;
  std::uint32_t scan = 0;
};

struct LidarReturns {
  std::vector<LidarReturn> all;
  std::uint32_t scans = 0;
  std::uint32_t duplicate_scans = 0;  ///< left out: equal to an earlier one to the last bit
  std::uint64_t second_returns = 0;   ///< left out: last returns behind the strongest
  std::uint64_t unknown_beams = 0;    ///< left out: of a ring that the sensor model has no beam for
};

/// Scans one after the other. One thread.
class ReturnCollector {
 public:
  explicit ReturnCollector(const models::LidarScan& scan) : beams_(scan.beams) {}
  /// Points of one scan in the sensor's frame.
  void add(std::span<const LidarPoint> points);
  [[nodiscard]] LidarReturns take() { return std::move(out_); }

 private:
  std::vector<models::LidarBeam> beams_;
  LidarReturns out_;
  std::unordered_set<std::uint64_t> seen_;
};

/// Remission E of the models (1: a white matt plate) for what the device told, by the sensor model's scale.
[[nodiscard]] double remission_from_units(const models::LidarRemission& r, double units, double range_m);

}  // namespace rigor::calibration
