#include "sim/world/graph/value.h"

#include <array>
#include <bit>
#include <cmath>

#include "sim/world/graph/same.h"

namespace rigor::world {

Pose Motion::at(BenchTime t) const {
  const double dt_s = (t - t_ref).seconds();
  Pose T = T_parent_node;
  if (dt_s == 0) return T;
  const double half_s = 0.5 * dt_s;
  T.translation() += (velocity_m_per_s + acceleration_m_per_s2 * half_s) * dt_s;
  const Vector3 mean_rate = angular_velocity_rad_per_s + angular_acceleration_rad_per_s2 * half_s;
  const double rate = mean_rate.norm();
  if (rate > 0) T.linear() = Eigen::AngleAxisd(rate * dt_s, mean_rate / rate).toRotationMatrix() * T.linear();
  return T;
}

bool Motion::operator==(const Motion& o) const { return same(*this, o); }

std::string_view name_of(ValueKind kind) noexcept {
  static constexpr std::array<std::string_view, 9> kNames = {"flag", "integer", "number",  "text", "vector3",
                                                             "pose", "motion",  "numbers", "blob"};
  const auto k = static_cast<std::size_t>(kind);
  return k < kNames.size() ? kNames[k] : "unknown";
}

bool same_value(const Value& a, const Value& b) {
  if (a.index() != b.index()) return false;
  return std::visit([&](const auto& v) { return same(v, *std::get_if<std::decay_t<decltype(v)>>(&b)); }, a);
}

}  // namespace rigor::world
