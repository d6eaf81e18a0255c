#include "sensor-hal/channel/pair_watch/kind_numbers.h"

#include <array>
#include <cmath>
#include <numbers>

#include "sensor-hal/types/geodetic.h"

namespace rigor::pair_watch {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180;

std::vector<WatchedValue> watched_values(SampleKind kind) {
  switch (kind) {
    case SampleKind::imu:
      return {{"specific force x", "m/s²", 0}, {"specific force y", "m/s²", 0},
              {"specific force z", "m/s²", 0}, {"angular rate x", "rad/s", 0},
              {"angular rate y", "rad/s", 0},  {"angular rate z", "rad/s", 0}};
    case SampleKind::nav_fix:
      return {{"east", "m", 0, false}, {"north", "m", 0, false}, {"up", "m", 0, false}};
    case SampleKind::odometry:
      return {{"forward velocity", "m/s", 0},
              {"turn rate", "rad/s", 0},
              {"left wheel", "rad/s", 0},
              {"right wheel", "rad/s", 0}};
    default:
      return {};
  }
}

}  // namespace

Result<KindNumbers> KindNumbers::make(SampleKind kind) {
  const auto values = watched_values(kind);
  if (values.empty())
    return fail(ErrorCode::bad_input, "kind", "expected imu, nav_fix or odometry, got another kind");
  auto change = ValueChange::make(values);
  if (!change) return tl::unexpected<Error>(change.error());
  return KindNumbers(kind, values.size(), std::move(*change));
}

bool KindNumbers::numbers_of(const Sample& s, std::span<double, kMost> out) const noexcept {
  if (s.kind() != kind_) return false;
  if (const auto* imu = s.as<ImuSample>()) {
    for (std::size_t i = 0; i < 3; ++i)
      out[i] = imu->specific_force_mps2[i], out[3 + i] = imu->angular_rate_radps[i];
  } else if (const auto* fix = s.as<NavFix>()) {
    if (fix->status == FixStatus::none) return false;
    const MetresPerRadian m = metres_per_radian(origin_.latitude_deg * kRadPerDeg, origin_.height_m);
    out[0] = std::remainder(fix->longitude_deg - origin_.longitude_deg, 360.0) * kRadPerDeg * m.east;
    out[1] = (fix->latitude_deg - origin_.latitude_deg) * kRadPerDeg * m.north;
    out[2] = fix->height_m - origin_.height_m;
  } else if (const auto* odometry = s.as<Odometry>()) {
    out[0] = odometry->velocity_mps[0], out[1] = odometry->turn_rate_radps[2];
    out[2] = odometry->wheel_rate_radps[0], out[3] = odometry->wheel_rate_radps[1];
  }
  return true;
}

bool KindNumbers::add(double t_s, const Sample& real, const Sample& simulated) noexcept {
  if (const auto* fix = simulated.as<NavFix>(); fix && !has_origin_ && fix->status != FixStatus::none)
    origin_ = *fix, has_origin_ = true;
  std::array<double, kMost> x{}, y{};
  return numbers_of(real, x) && numbers_of(simulated, y) &&
         values_.add(t_s, {x.data(), count_}, {y.data(), count_});
}

}  // namespace rigor::pair_watch
