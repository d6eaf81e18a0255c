#include "sensor-hal/channel/providers.h"

#include <cmath>

namespace rigor {

Pose BodyState::at(BenchTime t) const noexcept {
  const double s = (t - t_ref).seconds();
  Pose pose = T_world_body;
  for (std::size_t i = 0; i < 3; ++i)
    pose.position_m[i] += s * (velocity_mps[i] + 0.5 * s * acceleration_mps2[i]);
  // The rotation vector w·s in the body's frame, appended on the right: q(t) = q_ref ∘ exp(w·s/2). Its half
  // angle's sine over the angle is taken from the series where the quotient would lose its digits.
  const auto& w = turn_rate_radps;
  const double angle = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * s;
  const double half = 0.5 * angle;
  const double k = s * (std::abs(half) < 1e-4 ? 0.5 * (1 - half * half / 6) : std::sin(half) / angle);
  const double bw = std::cos(half), bx = w[0] * k, by = w[1] * k, bz = w[2] * k;
  const auto [aw, ax, ay, az] = T_world_body.orientation_wxyz;
  std::array<double, 4> q{aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
                          aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw};
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (auto& x : q) x /= norm;
  pose.orientation_wxyz = q;
  return pose;
}

}  // namespace rigor
