// From a pixel to a point. Of measurement id m out of W, a row with azimuth angle a and altitude angle b, and
// range r (Ouster's Firmware User Manual 3.1, "Lidar Range to XYZ"):
//
//   e = 2π (1 − m/W),  c = e − a                                encoder; beam, in the lidar's frame
//   p_lidar = (r − |n|) (cos b cos c, cos b sin c, sin b) + (n_x cos e, n_x sin e, n_z)
//   p_sensor = T_sensor_lidar p_lidar
//
// n is where beams begin, against the lidar's origin.
#pragma once

#include <array>
#include <vector>

#include "drivers/ouster/sensor_metadata.h"

namespace rigor::ouster {

/// Setup: create, copy. The rest: any thread, no allocation.
class BeamTable {
 public:
  explicit BeamTable(const Metadata& metadata);
  struct Point {
    float x_m, y_m, z_m;
  };
  /// In the sensor's frame. Precondition: column < W, row < rows.
  [[nodiscard]] Point at(std::uint32_t column, std::uint32_t row, double range_m) const {
    const Column& c = columns_[column];
    const std::array<double, 3>& d = rows_[row];
    const double r = range_m - beam_origin_m_;
    return {static_cast<float>(r * (c.m[0] * d[0] + c.m[1] * d[1] + c.m[2] * d[2]) + c.offset_m[0]),
            static_cast<float>(r * (c.m[3] * d[0] + c.m[4] * d[1] + c.m[5] * d[2]) + c.offset_m[1]),
            static_cast<float>(r * (c.m[6] * d[0] + c.m[7] * d[1] + c.m[8] * d[2]) + c.offset_m[2])};
  }

 private:
  struct Column {
    std::array<double, 9> m;  ///< the sensor's rotation times that of the encoder
    std::array<double, 3> offset_m;
  };
  std::vector<Column> columns_;
  std::vector<std::array<double, 3>> rows_;  ///< directions at encoder angle 0
  double beam_origin_m_;
};

}  // namespace rigor::ouster
