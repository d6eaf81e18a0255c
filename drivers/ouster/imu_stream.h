// From IMU packets in the order of their arrival to readings with their place on the bench clock. No socket,
// no thread. IMU packets are not numbered: what is missing shows as gaps in the sensor's own time.
#pragma once

#include <optional>

#include "drivers/lidar/packet_clock.h"
#include "drivers/ouster/lidar_packet.h"
#include "sensor-hal/types/sample.h"

namespace rigor::ouster {

class ImuStream {
 public:
  struct Options {
    packet_lidar::TimeSource time = packet_lidar::TimeSource::device;
    Duration utc_offset{};
    Duration period = milliseconds(10);
  };
  struct Reading {
    ImuSample imu;
    BenchTime t_capture;
    Duration sigma;
    std::uint64_t sequence = 0, lost_before = 0;
    std::uint32_t validity = 0;
  };
  struct Counters {
    std::uint64_t packets = 0, malformed = 0, packets_lost = 0, clock_steps = 0;
  };

  explicit ImuStream(const Options& options);
  /// I/O thread, no allocation. Empty: no IMU packet, or one that is not newer than the one before.
  [[nodiscard]] std::optional<Reading> take(Bytes datagram, BenchTime arrival);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return clock_; }
  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  Options options_;
  packet_lidar::PacketClock clock_;
  bool any_ = false;
  DeviceTime last_;
  std::uint64_t sequence_ = 0;
  Counters counters_;
};

}  // namespace rigor::ouster
