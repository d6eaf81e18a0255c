#include "drivers/lidar/packet_clock.h"

namespace rigor::packet_lidar {
namespace {

ClockMapOptions clock_options(const PacketClock::Options& o) {
  ClockMapOptions c;
  c.resolution = o.resolution;
  c.min_delay = o.fill;
  c.min_delay_sigma = o.delay_sigma;
  return c;
}

}  // namespace

PacketClock::PacketClock(const Options& options) : options_(options), clock_(clock_options(options)) {}

bool PacketClock::observe(DeviceTime t, Duration fill, BenchTime arrival) {
  if (options_.source == TimeSource::arrival)
    arrival_offset_ = Duration(arrival.ns() - fill.ns() - t.ns());
  else if (options_.source == TimeSource::device)
    // The map's least delay stands for a usual packet.
    return clock_.add_arrival(t, arrival - (fill - options_.fill)) != ClockMap::Update::reset;
  return true;
}

PacketClock::Placed PacketClock::place(DeviceTime t) const {
  switch (options_.source) {
    case TimeSource::fixed:
      return {BenchTime(t.ns() + fixed_offset_.ns()), Duration((options_.resolution.ns() * 289 + 500) / 1000),
              true};  // resolution / √12
    case TimeSource::utc:
      return {epoch_.to_bench(RealtimeTime(t.ns() + utc_offset_.ns())), microseconds(1) + epoch_.sigma, true};
    case TimeSource::arrival:
      return {BenchTime(t.ns() + arrival_offset_.ns()), microseconds(100), true};
    case TimeSource::device:
      break;
  }
  const Mapped m = clock_.map(t);
  return {m.t, m.sigma, m.known};
}

}  // namespace rigor::packet_lidar
