#include "drivers/ouster/beam_table.h"

#include <cmath>
#include <numbers>

namespace rigor::ouster {

BeamTable::BeamTable(const Metadata& m) : beam_origin_m_(std::hypot(m.beam_origin_m, m.beam_origin_z_m)) {
  constexpr double kDegree = std::numbers::pi / 180;
  for (std::size_t row = 0; row < m.beam_altitude_deg.size(); ++row) {
    const double a = -m.beam_azimuth_deg[row] * kDegree, b = m.beam_altitude_deg[row] * kDegree;
    rows_.push_back({std::cos(b) * std::cos(a), std::cos(b) * std::sin(a), std::sin(b)});
  }
  const auto& t = m.T_sensor_lidar;
  for (std::uint32_t column = 0; column < m.mode.columns; ++column) {
    const double e = 2 * std::numbers::pi * (1 - static_cast<double>(column) / m.mode.columns);
    const double c = std::cos(e), s = std::sin(e);
    Column out{};
    for (std::size_t i = 0; i < 3; ++i) {
      const double x = t[4 * i], y = t[4 * i + 1], z = t[4 * i + 2];
      out.m[3 * i] = x * c + y * s;
      out.m[3 * i + 1] = y * c - x * s;
      out.m[3 * i + 2] = z;
      out.offset_m[i] = m.beam_origin_m * (x * c + y * s) + m.beam_origin_z_m * z + t[4 * i + 3];
    }
    columns_.push_back(out);
  }
}

}  // namespace rigor::ouster
