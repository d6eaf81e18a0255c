// From lidar packets in the order of their arrival to point clouds, or to images (frame_image.h), with their
// place on the bench clock. What
// the source on the network, a recording and the stand-in in virtual time share; no socket, no thread.
//
//   datagram → checked → its frame, by frame id → a cloud, once all columns of the azimuth window are there
//   or a packet of the next frame is
//
// A cloud's t_capture is the window's first column, also where that one is lost: columns are a column period
// apart. The first frame is handed on only if it was seen from its beginning. What is missing is counted:
// packets by the slots of a frame that nothing came for, columns by their status, frames by the gaps in frame
// ids. A frame that lacks anything is marked incomplete.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "drivers/lidar/cloud.h"
#include "drivers/lidar/packet_clock.h"
#include "drivers/ouster/beam_table.h"
#include "drivers/ouster/frame_image.h"
#include "drivers/ouster/lidar_packet.h"

namespace rigor::ouster {

struct FrameStreamOptions {
  packet_lidar::TimeSource time = packet_lidar::TimeSource::device;
  Duration utc_offset{};  ///< for TimeSource::utc: UTC less the device's time (PTP counts TAI: −37 s)
  Field remission = Field::reflectivity;  ///< what LidarPoint has of a pixel; not the range
  std::optional<ImageOptions> image{};    ///< images in place of points
  /// Packets of another initialization than the metadata's are left alone: their metadata has to be fetched.
  bool this_initialization_only = false;
};

class FrameStream {
 public:
  struct Counters {
    std::uint64_t packets = 0, malformed = 0;
    std::uint64_t frames = 0, frames_lost = 0;  ///< lost: whole ones, by the gaps in frame ids
    std::uint64_t packets_lost = 0;             ///< of frames of which something came
    std::uint64_t columns_lost = 0;             ///< of those frames: they did not come, or not good
    std::uint64_t packets_late = 0;             ///< of frames that were handed on already, and repeated ones
    std::uint64_t clock_steps = 0, restarts = 0;  ///< the device's clock, its count of frames
    std::uint64_t other_initialization =
        0;  ///< packets of a sensor that was configured anew since the metadata
    PacketFault last_fault = PacketFault::none;
  };

  FrameStream(const Metadata& metadata, const FrameStreamOptions& options);

  /// I/O thread. `arrival`: when its last byte was here. No allocation.
  void take(Bytes datagram, BenchTime arrival, const packet_lidar::HandCloud& hand);
  /// The sensor was configured anew: its next packets are by this metadata. False, and nothing happens, where
  /// its frames are larger than those of the first metadata, or make no such image. Allocates.
  [[nodiscard]] bool adopt(const Metadata& metadata);
  /// The end of the packets: hands on what is at hand if it is whole.
  void finish(const packet_lidar::HandCloud& hand);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return clock_; }
  /// As new: what was being collected is dropped, the clock is forgotten.
  void reset();

  [[nodiscard]] const Counters& counters() const { return counters_; }
  [[nodiscard]] const Metadata& metadata() const { return metadata_; }
  [[nodiscard]] const PacketLayout& layout() const { return layout_; }
  /// Of a stream of images; nullptr: points.
  [[nodiscard]] const FrameImage* image() const { return image_ ? &*image_ : nullptr; }
  /// Of one cloud: a point for each pixel (and return) of the window.
  [[nodiscard]] static std::size_t max_points(const Metadata& metadata);

 private:
  void expect();
  void begin(std::uint16_t frame_id, std::uint32_t first_slot);
  void close(const packet_lidar::HandCloud& hand);
  void add(const LidarPacket& packet, std::uint32_t slot);
  void add_points(const LidarPacket::Column& column, std::int32_t t_offset_ns);

  Metadata metadata_;
  PacketLayout layout_;
  FrameStreamOptions options_;
  BeamTable beams_;
  packet_lidar::PacketClock clock_;
  Duration column_period_;
  std::vector<std::uint8_t> expected_;  ///< by slot: the columns of the window in it
  std::uint32_t expected_slots_ = 0, first_slot_ = 0;
  Counters counters_;

  // The frame at hand.
  bool open_ = false, whole_ = false;
  std::uint16_t frame_id_ = 0;
  std::vector<std::uint8_t> seen_;  ///< by slot
  std::uint32_t seen_slots_ = 0, columns_ = 0;
  bool timed_ = false;
  DeviceTime t_begin_;
  std::vector<LidarPoint> points_;
  std::optional<FrameImage> image_;
  // The sequence of clouds.
  bool started_ = false, any_begun_ = false;  ///< a frame was seen; from its beginning
  bool renewed_ = false;  ///< other metadata, or the sensor started anew: frames are counted from there
  DeviceTime t_last_;
  std::uint64_t sequence_ = 0, lost_clouds_ = 0;
};

}  // namespace rigor::ouster
