#include "sensor-hal/channel/pair_values.h"

#include <cmath>
#include <numbers>

#include "sensor-hal/types/geodetic.h"
#include "sensor-hal/types/orientation.h"

namespace rigor {
namespace {

constexpr std::array<ComparedValue, 6> kComparedImu{{{"specific force x", "m/s²"},
                                                     {"specific force y", "m/s²"},
                                                     {"specific force z", "m/s²"},
                                                     {"angular rate x", "rad/s"},
                                                     {"angular rate y", "rad/s"},
                                                     {"angular rate z", "rad/s"}}};
constexpr std::array<ComparedValue, 3> kNavFix{{{"east", "m"}, {"north", "m"}, {"up", "m"}}};
constexpr std::array<ComparedValue, 7> kComparedOdometry{{{"x", "m"},
                                                          {"y", "m"},
                                                          {"yaw", "rad"},
                                                          {"forward velocity", "m/s"},
                                                          {"turn rate", "rad/s"},
                                                          {"left wheel angle", "rad"},
                                                          {"right wheel angle", "rad"}}};

double within_half_turn(double angle_rad) noexcept { return std::remainder(angle_rad, 2 * std::numbers::pi); }

}  // namespace

std::span<const ComparedValue> compared_values(SampleKind kind) noexcept {
  switch (kind) {
    case SampleKind::imu:
      return kComparedImu;
    case SampleKind::nav_fix:
      return kNavFix;
    case SampleKind::odometry:
      return kComparedOdometry;
    default:
      return {};
  }
}

std::uint32_t value_differences(const Sample& real, const Sample& simulated,
                                std::array<double, RegisterBlock::kMax>& difference) noexcept {
  if (real.kind() != simulated.kind()) return 0;
  if (const auto* a = real.as<RegisterBlock>()) {
    const auto& b = *simulated.as<RegisterBlock>();
    if (a->count != b.count || a->count > RegisterBlock::kMax) return 0;
    for (std::uint32_t i = 0; i < a->count; ++i) difference[i] = a->value[i] - b.value[i];
    return a->count;
  }
  std::uint32_t n = 0;
  const auto add = [&](double d) { difference[n++] = d; };
  if (const auto* a = real.as<ImuSample>()) {
    const auto& b = *simulated.as<ImuSample>();
    for (std::size_t i = 0; i < 3; ++i) add(a->specific_force_mps2[i] - b.specific_force_mps2[i]);
    for (std::size_t i = 0; i < 3; ++i) add(a->angular_rate_radps[i] - b.angular_rate_radps[i]);
  } else if (const auto* f = real.as<NavFix>()) {
    const auto& g = *simulated.as<NavFix>();
    if (f->status == FixStatus::none || g.status == FixStatus::none) return 0;
    constexpr double kRadPerDeg = std::numbers::pi / 180;
    const MetresPerRadian m = metres_per_radian(f->latitude_deg * kRadPerDeg, f->height_m);
    add(within_half_turn((f->longitude_deg - g.longitude_deg) * kRadPerDeg) * m.east);
    add((f->latitude_deg - g.latitude_deg) * kRadPerDeg * m.north);
    add(f->height_m - g.height_m);
  } else if (const auto* o = real.as<Odometry>()) {
    const auto& p = *simulated.as<Odometry>();
    add(o->T_odom_base.position_m[0] - p.T_odom_base.position_m[0]);
    add(o->T_odom_base.position_m[1] - p.T_odom_base.position_m[1]);
    add(within_half_turn(yaw_of(o->T_odom_base.orientation_wxyz) - yaw_of(p.T_odom_base.orientation_wxyz)));
    add(o->velocity_mps[0] - p.velocity_mps[0]);
    add(o->turn_rate_radps[2] - p.turn_rate_radps[2]);
    add(o->wheel_angle_rad[0] - p.wheel_angle_rad[0]);
    add(o->wheel_angle_rad[1] - p.wheel_angle_rad[1]);
  }
  return n;
}

}  // namespace rigor
