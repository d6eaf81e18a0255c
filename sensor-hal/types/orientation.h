// Roll, pitch and yaw of an orientation as samples carry it: a unit quaternion in the order w, x, y, z.
// Positive turns about x (roll), y (pitch) and z (yaw) of the parent, in this order: R = Rz(yaw) · Ry(pitch)
// · Rx(roll).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

namespace rigor {

[[nodiscard]] inline double yaw_of(const std::array<double, 4>& wxyz) noexcept {
  const auto& [w, x, y, z] = wxyz;
  return std::atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
}
[[nodiscard]] inline std::array<double, 3> roll_pitch_yaw_of(const std::array<double, 4>& wxyz) noexcept {
  const auto& [w, x, y, z] = wxyz;
  return {std::atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
          std::asin(std::clamp(2 * (w * y - z * x), -1.0, 1.0)), yaw_of(wxyz)};
}
[[nodiscard]] inline std::array<double, 4> from_roll_pitch_yaw(double roll_rad, double pitch_rad,
                                                               double yaw_rad) noexcept {
  const double cr = std::cos(roll_rad / 2), sr = std::sin(roll_rad / 2), cp = std::cos(pitch_rad / 2),
               sp = std::sin(pitch_rad / 2), cy = std::cos(yaw_rad / 2), sy = std::sin(yaw_rad / 2);
  return {cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
          cr * cp * sy - sr * sp * cy};
}

}  // namespace rigor
