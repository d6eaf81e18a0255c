// A stiff chassis on springs on the ground: how the speed of its wheels becomes a way through the world. One
// step of any ground vehicle; the vehicle's own model says how fast it goes, forward, sideways, turning.
//
// Place and yaw follow the wheels. Height, roll and pitch follow the plane under the wheels as a mass on a
// spring and damper whose foot is that plane: z'' = w²·(g − z) + 2·d·w·(g' − z'). On an even slope it stays
// on the plane exactly; over an edge it swings in. Within a step velocities go linearly (positions by the
// trapezoid), so that position, velocity and acceleration at any instant belong together exactly.
#pragma once

#include <array>

#include "sensor-hal/channel/providers.h"
#include "sim/platform/ground.h"

namespace rigor {

struct Suspension {
  double frequency_hz = 3;  ///< of the springs, of height, roll and pitch alike
  double damping = 0.7;     ///< of the critical damping
};

struct ChassisState {
  std::array<double, 3> position_m{}, velocity_mps{};  ///< of the origin, in the world
  std::array<double, 3> angle_rad{}, rate_radps{};     ///< roll, pitch, yaw: R = Rz·Ry·Rx
  std::array<double, 3> ground{}, ground_rate{};       ///< z, roll, pitch of the plane under the wheels
};

/// The chassis at rest on the ground. Where there is none: level, at z 0.
[[nodiscard]] ChassisState chassis_at_rest(const Footprint& wheels, const Ground& ground, double x_m,
                                           double y_m, double yaw_rad);

/// Speeds in the vehicle's axes at the end of a step.
struct ChassisSpeed {
  double forward_mps = 0, left_mps = 0;
  double turn_radps = 0;  ///< about the vehicle's z
};
/// `on_ground` is false where a wheel has none; the chassis then stays as high and as tilted as it was.
[[nodiscard]] ChassisState step_chassis(const ChassisState& from, const ChassisSpeed& speed,
                                        const Suspension& suspension, const Footprint& wheels,
                                        const Ground& ground, double step_s, bool& on_ground) noexcept;

/// Between two steps, `since_s` after the first.
[[nodiscard]] BodyState body_between(const ChassisState& before, const ChassisState& after, double step_s,
                                     double since_s, BenchTime t) noexcept;

/// Sine of the slope ahead: positive uphill; and to the left.
[[nodiscard]] double slope_ahead(const ChassisState& s) noexcept;
[[nodiscard]] double slope_left(const ChassisState& s) noexcept;

}  // namespace rigor
