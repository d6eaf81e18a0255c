// From IMU packets in the order of their arrival to readings with their place on the bench clock. No socket,
// no thread.
#pragma once

#include <optional>

#include "drivers/lidar/reading_stream.h"
#include "drivers/ouster/lidar_packet.h"

namespace rigor::ouster {

class ImuStream {
 public:
  struct Options {
    packet_lidar::TimeSource time = packet_lidar::TimeSource::device;
    Duration utc_offset{};
    Duration period = milliseconds(10);
  };
  struct Counters {
    std::uint64_t packets = 0, packets_lost = 0, clock_steps = 0;
    std::uint64_t malformed = 0;  ///< no IMU packets, and those that are not newer than the one before
  };

  explicit ImuStream(const Options& options) : readings_({options.time, options.period}) {
    readings_.clock().set_utc_offset(options.utc_offset);
  }
  /// I/O thread, no allocation. Empty: malformed.
  [[nodiscard]] std::optional<packet_lidar::Reading> take(Bytes datagram, BenchTime arrival);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return readings_.clock(); }
  [[nodiscard]] Counters counters() const;

 private:
  packet_lidar::ReadingStream readings_;
  std::uint64_t malformed_ = 0;
};

}  // namespace rigor::ouster
