// From packets in the order of their arrival to point clouds with their place on the bench clock. What the
// source on the network, a recording and the stand-in in virtual time share; no socket, no thread.
//
//   datagram → checked → points by their times → a cloud, once its frame's time is over
//
// The device sends points without end and knows no frames that a scan would begin with: frames here are
// stretches of its own time, frame n from n · frame to (n + 1) · frame, also within a packet. A cloud's
// t_capture is the frame's beginning, t_offset_ns of a point counts from there. The first frame is handed on
// only if it was seen from its beginning.
//
// What is missing shows in udp_cnt, which counts packets; where it begins anew (a frame of the device, its
// start) or disagrees with the timestamps, these say how many. A frame that lacks a packet is marked
// incomplete; frames of which nothing came leave a gap in the sequence.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "drivers/lidar/cloud.h"
#include "drivers/lidar/packet_clock.h"
#include "drivers/livox/livox_packet.h"

namespace rigor::livox {

/// UTC less the device's time. PTP counts TAI.
[[nodiscard]] constexpr Duration utc_less(TimeType type) {
  return type == TimeType::ptp ? seconds(-37) : Duration(0);
}

struct PointStreamOptions {
  packet_lidar::TimeSource time = packet_lidar::TimeSource::device;
  std::optional<Duration> utc_offset{};  ///< for `utc`: UTC less the device's time; empty: by its time_type
  Duration frame = milliseconds(100);
  bool drop_noise = false;  ///< points whose tag says medium or low confidence
};

class PointStream {
 public:
  struct Counters {
    std::uint64_t packets = 0, malformed = 0, packets_lost = 0;
    std::uint64_t packets_late = 0;  ///< repeated, or overtaken by others
    std::uint64_t clock_steps = 0;   ///< of the device: set anew, or started anew
    std::uint64_t frames = 0, frames_incomplete = 0;
    std::uint64_t points = 0, noise = 0;  ///< of good packets: returns; those that were left out
    std::uint64_t points_dropped = 0;     ///< more than a frame can have
    PacketFault last_fault = PacketFault::none;
  };

  explicit PointStream(const PointStreamOptions& options);

  /// I/O thread. `arrival`: when its last byte was here. No allocation after construction.
  void take(Bytes datagram, BenchTime arrival, const packet_lidar::HandCloud& hand);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return clock_; }
  /// As new: what was being collected is dropped, the clock is forgotten.
  void reset();

  [[nodiscard]] const Counters& counters() const { return counters_; }
  /// Of the last good packet.
  [[nodiscard]] TimeType time_type() const { return time_type_; }
  [[nodiscard]] DataType data_type() const { return data_type_; }
  /// Of one cloud.
  [[nodiscard]] std::size_t max_points() const { return max_points_; }

 private:
  [[nodiscard]] bool in_order(const Packet& packet, DeviceTime t, BenchTime arrival);
  void lose(std::uint64_t packets, DeviceTime from, DeviceTime to);
  void forget();
  void begin(std::int64_t frame, DeviceTime first);
  void close(const packet_lidar::HandCloud& hand);

  PointStreamOptions options_;
  packet_lidar::PacketClock clock_;
  std::size_t max_points_;
  Counters counters_;
  TimeType time_type_ = TimeType::none;
  DataType data_type_ = DataType::cartesian_mm;

  bool any_packet_ = false;
  DeviceTime t_last_;  ///< of the last packet's first point
  BenchTime t_last_arrival_;
  std::int64_t filled_ns_ = 0;  ///< what it took
  std::uint16_t last_count_ = 0;
  DeviceTime lost_from_, lost_to_;  ///< what is missing last; empty where equal
  // The frame at hand.
  bool open_ = false, whole_ = false, incomplete_ = false;
  std::int64_t frame_ = 0;
  std::uint32_t lost_inside_ = 0;
  std::vector<LidarPoint> points_;
  // The sequence of clouds.
  bool started_ = false, last_handed_ = false;
  std::uint64_t sequence_ = 0, lost_clouds_ = 0;
};

}  // namespace rigor::livox
