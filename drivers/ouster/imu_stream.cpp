#include "drivers/ouster/imu_stream.h"

#include <algorithm>
#include <numbers>
#include <utility>

namespace rigor::ouster {

ImuStream::ImuStream(const Options& options)
    : options_(options), clock_({options.time, nanoseconds(1), Duration(0)}) {
  clock_.set_utc_offset(options.utc_offset);
}

std::optional<ImuStream::Reading> ImuStream::take(Bytes datagram, BenchTime arrival) {
  const auto packet = parse_imu(datagram);
  if (!packet) {
    ++counters_.malformed;
    return {};
  }
  ++counters_.packets;
  const DeviceTime t(static_cast<std::int64_t>(packet->accelerometer_ns & 0x3FFF'FFFF'FFFF'FFFF));
  if (!clock_.observe(t, Duration(0), arrival)) ++counters_.clock_steps;
  Reading r;
  if (std::exchange(any_, true)) {
    const std::int64_t step = (t - last_).ns(), period = std::max<std::int64_t>(1, options_.period.ns());
    if (step <= 0 && step > -1'000'000'000) {
      --counters_.packets;
      ++counters_.malformed;  // repeated, or overtaken
      return {};
    }
    // Set anew, or away for long: what was lost is not known.
    if (step > 0 && step < 60'000'000'000)
      r.lost_before = static_cast<std::uint64_t>(std::max<std::int64_t>(0, (step + period / 2) / period - 1));
    sequence_ += 1 + r.lost_before;
    counters_.packets_lost += r.lost_before;
  }
  last_ = t;
  constexpr double kG = 9.80665;
  for (std::size_t i = 0; i < 3; ++i) {
    r.imu.specific_force_mps2[i] = static_cast<double>(packet->acceleration_g[i]) * kG;
    r.imu.angular_rate_radps[i] = static_cast<double>(packet->turn_rate_dps[i]) * (std::numbers::pi / 180);
  }
  const auto at = clock_.place(t);
  r.t_capture = at.t;
  r.sigma = at.sigma;
  r.sequence = sequence_;
  if (!at.known) r.validity |= kClockUnsure;
  return r;
}

}  // namespace rigor::ouster
