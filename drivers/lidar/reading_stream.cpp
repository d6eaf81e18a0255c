#include "drivers/lidar/reading_stream.h"

#include <algorithm>
#include <utility>

namespace rigor::packet_lidar {

std::optional<Reading> ReadingStream::take(DeviceTime t, const ImuSample& imu, BenchTime arrival) {
  Reading r;
  if (std::exchange(any_, true)) {
    const std::int64_t step = (t - last_).ns(), period = std::max<std::int64_t>(1, options_.period.ns());
    if (step <= 0 && step > -20'000'000) {
      ++counters_.repeated;
      return {};
    }
    // Set anew, or away for long: what was lost is not known.
    if (step > 0 && step < 60'000'000'000)
      r.lost_before = static_cast<std::uint64_t>(std::max<std::int64_t>(0, (step + period / 2) / period - 1));
    sequence_ += 1 + r.lost_before;
    counters_.lost += r.lost_before;
  }
  if (!clock_.observe(t, Duration(0), arrival)) ++counters_.clock_steps;
  ++counters_.readings;
  last_ = t;
  r.imu = imu;
  const PacketClock::Placed at = clock_.place(t);
  r.t_capture = at.t;
  r.sigma = at.sigma;
  r.sequence = sequence_;
  if (!at.known) r.validity |= kClockUnsure;
  return r;
}

}  // namespace rigor::packet_lidar
