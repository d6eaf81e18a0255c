// When two values count as the same: bit by bit, but any NaN is as good as another.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <string>

#include "sim/world/graph/value.h"

namespace rigor::world {

[[nodiscard]] inline bool same(bool a, bool b) { return a == b; }
[[nodiscard]] inline bool same(std::int64_t a, std::int64_t b) { return a == b; }
[[nodiscard]] inline bool same(double a, double b) {
  return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b) ||
         (std::isnan(a) && std::isnan(b));
}
[[nodiscard]] inline bool same(const std::string& a, const std::string& b) { return a == b; }
[[nodiscard]] inline bool same(const Vector3& a, const Vector3& b) {
  return same(a.x(), b.x()) && same(a.y(), b.y()) && same(a.z(), b.z());
}
[[nodiscard]] inline bool same(const Pose& a, const Pose& b) {
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c)
      if (!same(a(r, c), b(r, c))) return false;
  return true;
}
[[nodiscard]] inline bool same(const Motion& a, const Motion& b) {
  return a.t_ref == b.t_ref && same(a.T_parent_node, b.T_parent_node) &&
         same(a.velocity_m_per_s, b.velocity_m_per_s) &&
         same(a.angular_velocity_rad_per_s, b.angular_velocity_rad_per_s) &&
         same(a.acceleration_m_per_s2, b.acceleration_m_per_s2) &&
         same(a.angular_acceleration_rad_per_s2, b.angular_acceleration_rad_per_s2);
}
[[nodiscard]] inline bool same(const Numbers& a, const Numbers& b) {
  if (a.span().data() == b.span().data() && a.size() == b.size()) return true;
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i)
    if (!same(a[i], b[i])) return false;
  return true;
}
[[nodiscard]] inline bool same(const Blob& a, const Blob& b) { return a == b; }

}  // namespace rigor::world
