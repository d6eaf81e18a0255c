// Readings of a LiDAR's inertial unit, in the order of their arrival, with their place on the bench clock.
// They are not numbered: what is missing shows as gaps in the device's own time. No socket, no thread.
#pragma once

#include <cstdint>
#include <optional>

#include "drivers/lidar/packet_clock.h"
#include "sensor-hal/types/sample.h"

namespace rigor::packet_lidar {

struct Reading {
  ImuSample imu;
  BenchTime t_capture;
  Duration sigma;
  std::uint64_t sequence = 0, lost_before = 0;
  std::uint32_t validity = 0;
};

class ReadingStream {
 public:
  struct Options {
    TimeSource time = TimeSource::device;
    Duration period = milliseconds(5);
  };
  struct Counters {
    std::uint64_t readings = 0, lost = 0, clock_steps = 0;
    std::uint64_t repeated = 0;  ///< or overtaken: not newer than the one before
  };

  explicit ReadingStream(const Options& options)
      : options_(options), clock_({options.time, nanoseconds(1), Duration(0)}) {}
  /// I/O thread, no allocation. Empty: not newer than the one before.
  [[nodiscard]] std::optional<Reading> take(DeviceTime t, const ImuSample& imu, BenchTime arrival);
  [[nodiscard]] PacketClock& clock() { return clock_; }
  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  Options options_;
  PacketClock clock_;
  bool any_ = false;
  DeviceTime last_;
  std::uint64_t sequence_ = 0;
  Counters counters_;
};

}  // namespace rigor::packet_lidar
