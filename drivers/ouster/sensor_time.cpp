#include "drivers/ouster/sensor_time.h"

#include <algorithm>
#include <cmath>

namespace rigor::ouster {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

}  // namespace

std::uint64_t SensorTime::count_at(RealtimeTime utc, RealtimeTime switched_on) const {
  std::int64_t ns = 0;
  switch (mode) {
    case Mode::internal:
      ns = (utc - switched_on).ns();
      break;
    case Mode::sync_pulse:
      ns = nmea ? (utc + nmea_leap).ns() : utc.ns() - switched_on.ns() / kSecond_ns * kSecond_ns;
      break;
    case Mode::ptp:
      ns = (utc + kTaiLessUtc).ns();
      break;
  }
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, ns));
}

RealtimeTime SensorTime::first_frame(RealtimeTime earliest, Duration frame_time) const {
  if (!phase_lock) return earliest;
  // The encoder counts down from a full turn at column 0: it passes the angle this much later.
  const double turn = std::fmod(360 - phase_lock_deg, 360) / 360;
  const auto lead = static_cast<std::int64_t>(std::llround(turn * static_cast<double>(frame_time.ns())));
  const std::int64_t beyond = (earliest.ns() + lead) % kSecond_ns % frame_time.ns();
  return earliest + Duration(beyond == 0 ? 0 : frame_time.ns() - beyond);
}

}  // namespace rigor::ouster
