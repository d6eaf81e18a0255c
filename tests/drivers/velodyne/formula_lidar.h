// A LiDAR whose ranges are a formula of where its beams point, with the scan of a Velodyne.
#pragma once

#include <cmath>
#include <cstring>
#include <numbers>
#include <string>

#include "drivers/velodyne/velodyne_device.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "tests/drivers/lidar/lidar_test_tools.h"

namespace rigor::velodyne::test {

class FormulaLidar final : public SampleProvider {
 public:
  explicit FormulaLidar(Model model, double rotation_hz, bool dual = false) : dual_(dual) {
    const DeviceFacts& f = facts_of(model);
    const Calibration c = factory_calibration(model);
    scan_.beams.resize(f.lasers);
    for (std::size_t i = 0; i < f.lasers; ++i) {
      scan_.beams[i].elevation_rad = c.lasers[i].elevation_rad;
      scan_.beams[i].vertical_offset_m = c.lasers[i].vertical_offset_m;
      scan_.beams[i].fire_time_s = static_cast<double>(f.laser_ns) * 1e-9 * static_cast<double>(i);
    }
    scan_.column_period_s = static_cast<double>(f.sequence_ns) * 1e-9;
    scan_.rotation_radps = -2 * std::numbers::pi * rotation_hz;
    scan_.columns = static_cast<std::uint32_t>(1 / rotation_hz / scan_.column_period_s) + 1;
  }
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, scan_.columns * scan_.beams.size() * 2 * sizeof(LidarPoint),
            "lidar"};
  }
  const models::LidarScan* scan() const override { return &scan_; }
  /// Of a beam at an anticlockwise azimuth; whole steps of 2 mm; none in a sector of 20 degrees behind.
  static double range_m(double azimuth_rad, std::size_t beam) {
    const double a = std::remainder(azimuth_rad, 2 * std::numbers::pi);
    if (std::abs(a) > std::numbers::pi - 0.17) return 0;
    return std::round((10 + 4 * std::sin(2 * a) + 0.1 * static_cast<double>(beam)) * 500) / 500;
  }
  Status capture(const Request& r, Sample& sample) override {
    std::vector<LidarPoint> points;
    for (std::uint32_t c = 0; c < scan_.columns; ++c)
      for (std::size_t b = 0; b < scan_.beams.size(); ++b) {
        const models::LidarBeam& beam = scan_.beams[b];
        const double a = scan_.azimuth_rad(c) + scan_.rotation_radps * beam.fire_time_s + r.turn_rad;
        const double range = range_m(a, b);
        if (range == 0) continue;
        for (std::uint8_t index = 0; index < (dual_ && b % 4 == 0 ? 2 : 1); ++index)
          points.push_back(packet_lidar::test::point_at(
              models::rotor_aim(beam, a), range + 2 * index, static_cast<double>(b * 5 + index),
              c * scan_.column_period_s + beam.fire_time_s, b, index));
      }
    packet_lidar::test::store_points(points, sample);
    return {};
  }

 private:
  models::LidarScan scan_;
  bool dual_;
};

/// Packets of an even rotor as a recording.
void record_rotor(const std::string& file, double rotation_hz, std::uint64_t packets);

}  // namespace rigor::velodyne::test
