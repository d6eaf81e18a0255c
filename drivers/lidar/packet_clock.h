// From the time in a device's packets to the bench clock, by one of
//   device   the quickest arrivals tie the device's clock down (ClockMap); good to some tens of µs
//   utc      it counts UTC (GPS, PTP): this machine's CLOCK_REALTIME leads to the bench
//   arrival  the arrival of each packet, less the time that it took to fill it
//   fixed    a constant is added (virtual time)
#pragma once

#include "rt-core/clock_map.h"
#include "rt-core/epoch.h"

namespace rigor::packet_lidar {

enum class TimeSource : std::uint8_t { device, utc, arrival, fixed };

/// One thread.
class PacketClock {
 public:
  struct Options {
    TimeSource source = TimeSource::device;
    Duration resolution = nanoseconds(1);  ///< of the device's counter
    Duration fill;  ///< of a usual packet: it leaves when its last laser has fired, not earlier
    Duration delay_sigma = microseconds(50);  ///< of what it takes beyond that
  };
  struct Placed {
    BenchTime t;
    Duration sigma;
    bool known;  ///< false: t means nothing yet
  };

  explicit PacketClock(const Options& options);

  /// For `utc`: how UTC and bench time hang together now. For `fixed`: what leads from device to bench time.
  void set_epoch(const EpochPair& epoch) { epoch_ = epoch; }
  void set_fixed_offset(Duration bench_minus_device) { fixed_offset_ = bench_minus_device; }
  /// For `utc`: what has to be added to the device's time.
  void set_utc_offset(Duration utc_minus_device) { utc_offset_ = utc_minus_device; }
  [[nodiscard]] const EpochPair& epoch() const { return epoch_; }
  [[nodiscard]] TimeSource source() const { return options_.source; }

  /// A packet whose first firing was at `t`, which took `fill` to be filled, was here at `arrival`. False:
  /// the device's clock stepped, and what was learned of it is forgotten. No allocation.
  bool observe(DeviceTime t, Duration fill, BenchTime arrival);
  /// For `device`: its clock was `t` at some instant in [before, after] (a time pulse). While there are such
  /// latches, arrivals tell nothing.
  void latch(DeviceTime t, BenchTime before, BenchTime after) { (void)clock_.add_latch(t, before, after); }
  [[nodiscard]] Placed place(DeviceTime t) const;
  void reset() { clock_.reset(); }

 private:
  Options options_;
  ClockMap clock_;
  EpochPair epoch_{};
  Duration fixed_offset_{}, utc_offset_{}, arrival_offset_{};
};

}  // namespace rigor::packet_lidar
