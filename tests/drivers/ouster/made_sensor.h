// A sensor of 32 beams whose metadata are made here, and a simulated LiDAR whose ranges are a formula of
// where its beams point.
#pragma once

#include <cmath>
#include <cstring>
#include <numbers>
#include <string>

#include "drivers/ouster/lidar_packet.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "tests/drivers/lidar/lidar_test_tools.h"

namespace rigor::ouster::test {

inline constexpr std::uint32_t kBeams = 32;
inline constexpr double kOrigin_m = 0.0158, kHeight_m = 0.03618, kDegree = std::numbers::pi / 180;

/// By row, from the top, in degrees; azimuths clockwise.
inline double altitude_deg(std::size_t row) { return 15.5 - static_cast<double>(row); }
inline double azimuth_deg(std::size_t row) { return static_cast<double>(row % 4) * 2.8 - 4.2; }

inline Metadata made_metadata(Profile profile = Profile::single, LidarMode mode = {512, 10}) {
  Metadata m;
  m.product_line = "OS-1-32", m.serial = "992000000001", m.status = "RUNNING";
  m.mode = mode, m.profile = profile, m.pixels_per_column = kBeams, m.window = {0, mode.columns - 1};
  m.pixel_shift.assign(kBeams, 0);
  for (std::size_t row = 0; row < kBeams; ++row) {
    m.beam_altitude_deg.push_back(altitude_deg(row));
    m.beam_azimuth_deg.push_back(azimuth_deg(row));
  }
  m.beam_origin_m = kOrigin_m;
  m.T_sensor_lidar = {-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, kHeight_m, 0, 0, 0, 1};
  return m;
}

class FormulaLidar final : public SampleProvider {
 public:
  explicit FormulaLidar(LidarMode mode = {512, 10}, bool dual = false) : dual_(dual) {
    scan_.columns = mode.columns;
    scan_.column_period_s = 1.0 / (mode.columns * mode.rate_hz);
    scan_.rotation_radps = -2 * std::numbers::pi * mode.rate_hz;
    scan_.start_azimuth_rad = std::numbers::pi;
    scan_.beams.resize(kBeams);
    for (std::size_t row = 0; row < kBeams; ++row) {
      models::LidarBeam& b = scan_.beams[row];
      b.elevation_rad = altitude_deg(row) * kDegree;
      b.azimuth_rad = -azimuth_deg(row) * kDegree;
      // At (n, 0) of the rotor, seen along the beam.
      b.radial_offset_m = kOrigin_m * std::cos(b.azimuth_rad);
      b.horizontal_offset_m = -kOrigin_m * std::sin(b.azimuth_rad);
      b.vertical_offset_m = kHeight_m;
    }
  }
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, scan_.columns * kBeams * 2 * sizeof(LidarPoint), "lidar"};
  }
  const models::LidarScan* scan() const override { return &scan_; }
  /// From where a beam begins; none in a sector.
  static double range_m(std::uint32_t column, std::size_t row) {
    return column % 64 == 5 ? 0
                            : 5 + 0.25 * static_cast<double>(column % 97) + 0.01 * static_cast<double>(row);
  }
  Status capture(const Request&, Sample& sample) override {
    std::vector<LidarPoint> points;
    for (std::uint32_t c = 0; c < scan_.columns; ++c)
      for (std::size_t row = 0; row < kBeams; ++row)
        for (std::uint8_t index = 0; index < (dual_ && row % 2 == 0 ? 2 : 1); ++index)
          if (range_m(c, row) != 0)
            points.push_back(packet_lidar::test::point_at(
                models::rotor_aim(scan_.beams[row], scan_.azimuth_rad(c)), range_m(c, row) + 2 * index,
                static_cast<double>(row * 5 + index), c * scan_.column_period_s, row, index));
    packet_lidar::test::store_points(points, sample);
    return {};
  }

 private:
  models::LidarScan scan_;
  bool dual_;
};

}  // namespace rigor::ouster::test
