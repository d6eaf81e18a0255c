// From datagrams in the order of their arrival to point clouds with their place on the bench clock. What the
// source on the network, a recording and the stand-in in virtual time share; no socket, no thread.
//
//   datagram → checked → decoded → cut into revolutions where the rotor passes `cut_cdeg` → cloud
//
// A cloud's t_capture is its first firing sequence, the points' t_offset_ns count from there. What comes
// before the first cut is no whole revolution and is not handed on. Lost packets show as gaps in the device's
// own time: they are counted, the cloud in which they are missing is marked incomplete, and revolutions that
// were lost altogether count as lost samples and leave a gap in the sequence.
//
// The device's time is µs since the hour. PacketClock leads from there to bench time; for its `utc` (PPS and
// NMEA are connected) the hour is that of this machine's CLOCK_REALTIME.
#pragma once

#include <cstdint>
#include <vector>

#include "drivers/lidar/cloud.h"
#include "drivers/lidar/packet_clock.h"
#include "drivers/velodyne/packet_decoder.h"

namespace rigor::velodyne {

using packet_lidar::Cloud;
using packet_lidar::HandCloud;
using packet_lidar::PacketClock;
using packet_lidar::TimeSource;
enum class CloudUnit : std::uint8_t { revolution, packet };

struct CloudStreamOptions {
  std::uint32_t cut_cdeg = 0;
  CloudUnit unit = CloudUnit::revolution;
  TimeSource time = TimeSource::device;
  Duration revolution = milliseconds(100);  ///< nominal: until it is measured
  std::size_t max_points = 0;               ///< of one cloud; what is beyond is dropped and marked
};

class CloudStream {
 public:
  struct Counters {
    std::uint64_t packets = 0, malformed = 0, packets_lost = 0, clock_steps = 0, points_dropped = 0;
    std::uint64_t full_turns = 0;  ///< good packets with an azimuth of 36000, which is 0
    PacketFault last_fault = PacketFault::none;
  };

  CloudStream(PacketDecoder decoder, const CloudStreamOptions& options);

  /// I/O thread. `arrival`: when its last byte was here. No allocation after the first revolution.
  void take(Bytes datagram, BenchTime arrival, const HandCloud& hand);
  [[nodiscard]] PacketClock& clock() { return clock_; }
  /// As new: what was being collected is dropped, the clock is forgotten.
  void reset();

  [[nodiscard]] const Counters& counters() const { return counters_; }
  [[nodiscard]] const ModelEvidence& evidence() const { return evidence_; }
  [[nodiscard]] const DeviceFacts& facts() const { return decoder_.facts(); }
  /// Product byte and return mode of the last good packet; 0 before.
  [[nodiscard]] std::uint8_t product() const { return product_; }
  [[nodiscard]] std::uint8_t return_mode() const { return mode_; }

 private:
  void observe(DeviceTime t, std::uint32_t us, BenchTime arrival, Duration filled);
  void begin(DeviceTime t, bool whole);
  void finish(const HandCloud& hand);
  void add(const DecodedPacket::Sequence& s, DeviceTime t_packet);

  PacketDecoder decoder_;
  CloudStreamOptions options_;
  DecodedPacket decoded_;
  HourClock hour_;
  PacketClock clock_;
  ModelEvidence evidence_;
  Counters counters_;
  std::uint8_t product_ = 0, mode_ = 0;

  bool any_packet_ = false;
  DeviceTime t_last_packet_;
  // The cloud at hand.
  std::vector<LidarPoint> points_;
  bool open_ = false, whole_ = false, truncated_ = false;
  DeviceTime t_begin_;
  double last_turn_cdeg_ = 0;  ///< azimuth beyond the cut
  std::uint32_t lost_inside_ = 0;
  // The sequence of clouds.
  bool any_begun_ = false, last_handed_ = false;
  DeviceTime t_last_begin_;
  std::uint64_t sequence_ = 0, lost_clouds_ = 0;
  Duration revolution_;
};

}  // namespace rigor::velodyne
