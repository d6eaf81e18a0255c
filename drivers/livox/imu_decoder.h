// Packets of the inertial unit as readings with their place on the bench clock; what is none is counted.
#pragma once

#include <optional>

#include "drivers/lidar/reading_stream.h"
#include "drivers/livox/livox_packet.h"

namespace rigor::livox {

class ImuDecoder {
 public:
  explicit ImuDecoder(const packet_lidar::ReadingStream::Options& options, std::optional<Duration> utc_offset)
      : stream_(options), time_(options.time), utc_offset_(utc_offset) {}
  [[nodiscard]] std::optional<packet_lidar::Reading> take(Bytes datagram, BenchTime arrival);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return stream_.clock(); }
  [[nodiscard]] const packet_lidar::ReadingStream::Counters& counters() const { return stream_.counters(); }
  [[nodiscard]] std::uint64_t malformed() const { return malformed_ + stream_.counters().repeated; }

 private:
  packet_lidar::ReadingStream stream_;
  packet_lidar::TimeSource time_;
  std::optional<Duration> utc_offset_;
  std::uint64_t malformed_ = 0;
};

}  // namespace rigor::livox
