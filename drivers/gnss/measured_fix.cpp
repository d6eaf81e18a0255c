#include "drivers/gnss/measured_fix.h"

#include <cmath>

#include "sensor-hal/models/markov_path.h"
#include "sensor-hal/types/geodetic.h"

namespace rigor::gnss {
namespace {

constexpr Duration kStep = milliseconds(10);

}  // namespace

MeasuredFix::MeasuredFix(const DeviceParts& parts, const std::string& name, std::uint64_t seed,
                         double velocity_sigma_mps)
    : samples_(parts.samples),
      motion_(parts.motion),
      key_(models::channel_key(seed, models::channel_id_from_name(name + ".velocity"))),
      velocity_sigma_mps_(velocity_sigma_mps) {}

Status MeasuredFix::check(const DeviceParts& parts, const std::string& place) {
  if (parts.samples && parts.samples->geometry().kind == SampleKind::nav_fix) return {};
  return fail(ErrorCode::bad_input, place,
              "expected the `sensor` of a satellite receiver (configs/sensors/gnss-*.yaml), got none");
}

bool MeasuredFix::capture(std::uint64_t index, BenchTime t, BenchTime t_start, NavFix& out) {
  SampleProvider::Request r;
  r.index = index;
  r.t_capture = t;
  r.t_start = t_start;
  if (motion_) r.motion = motion_->motion_at(t);
  if (!samples_->capture(r, sample_)) return false;
  const NavFix* fix = sample_.as<NavFix>();
  if (!fix) return false;
  out = *fix;
  return out.status != FixStatus::none;
}

Measured MeasuredFix::at(std::uint64_t index, BenchTime t, BenchTime t_start) {
  Measured m;
  NavFix before;
  // The earlier one first: what moves is asked in the order of time. Draws are keyed by the index, so both
  // have the same errors, and their difference is the way of the antenna alone.
  const bool moved = capture(index, t - kStep, t_start, before);
  if (!capture(index, t, t_start, m.fix)) {
    m.fix.status = FixStatus::none;
    return m;
  }
  if (!moved) return m;
  const auto per_rad = metres_per_radian(m.fix.latitude_deg * kRadPerDeg, m.fix.height_m);
  const double h_s = kStep.seconds();
  const auto noise = models::normal_draws(key_, models::NoiseEffect::gnss_white, index, 0);
  const double east_m =
      std::remainder(m.fix.longitude_deg - before.longitude_deg, 360) * kRadPerDeg * per_rad.east;
  const double north_m = (m.fix.latitude_deg - before.latitude_deg) * kRadPerDeg * per_rad.north;
  const std::array<double, 3> way_m{east_m, north_m, m.fix.height_m - before.height_m};
  for (std::size_t i = 0; i < 3; ++i) m.velocity_enu_mps[i] = way_m[i] / h_s + velocity_sigma_mps_ * noise[i];
  return m;
}

}  // namespace rigor::gnss
