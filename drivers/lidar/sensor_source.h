// A source of points, or of the inertial unit that sits in the same device: what a channel's kind decides.
//
//   do_arm    open_clouds(…) or open_readings(…)
//   thread    stream.take(datagram, arrival, hand()) or hand_reading(reading)
#pragma once

#include "drivers/lidar/cloud_source.h"
#include "drivers/lidar/reading_stream.h"

namespace rigor::packet_lidar {

class SensorSource : public CloudSource {
 protected:
  /// Setup: memory for readings.
  void open_readings(std::size_t buffers, Feed feed);
  /// Producer thread.
  void hand_reading(const Reading& reading) noexcept;
  [[nodiscard]] bool is_imu() const { return description_.kind == SampleKind::imu; }
  /// Producer thread, in virtual time: whether a sample was handed over that is released after `now`.
  [[nodiscard]] bool handed_past(BenchTime now) const {
    return is_imu() ? last_reading_release_ > now : handed_beyond(now);
  }

 private:
  Feed feed_ = Feed::live;
  RunSequence in_run_;
  BenchTime last_reading_release_{};
};

}  // namespace rigor::packet_lidar
