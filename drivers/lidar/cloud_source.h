// What sources of packet LiDARs share: clouds of a stream, or its images, become samples of a channel.
//
//   do_arm    open_clouds(buffers, max_points, Feed::live)
//   thread    stream.take(datagram, arrival, hand())          // calls hand_cloud for each cloud
//   do_stop   join the thread, then close_stream()
#pragma once

#include "drivers/lidar/cloud.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::packet_lidar {

class CloudSource : public StreamSource {
 protected:
  /// Where the packets come from: a device that measures since before the run; packets of a recording, which
  /// begins with the run; either in virtual time.
  enum class Feed : std::uint8_t { live, recording, virtual_time };
  /// Setup: memory for clouds of up to `max_points`.
  void open_clouds(std::size_t buffers, std::size_t max_points, Feed feed);
  /// Setup: memory for images of `bytes` each; `info`: what each of them is (ImageInfo, RangeImageInfo).
  void open_images(std::size_t buffers, const decltype(Sample::info)& info, std::size_t bytes, Feed feed);
  /// Producer thread.
  [[nodiscard]] const HandCloud& hand() const { return hand_; }
  /// Producer thread: how many datagrams were no packets so far; new ones are protocol errors.
  void count_malformed(std::uint64_t malformed) noexcept;
  /// Producer thread, in virtual time: whether a cloud was handed over that is released after `now`.
  [[nodiscard]] bool handed_beyond(BenchTime now) const { return any_handed_ && last_release_ > now; }

 private:
  void open(std::size_t buffers, std::size_t bytes, Feed feed);
  void hand_cloud(const Cloud& cloud) noexcept;

  HandCloud hand_ = [this](const Cloud& c) { hand_cloud(c); };
  Feed feed_ = Feed::live;
  decltype(Sample::info) image_;  ///< of a channel of images
  RunSequence in_run_;
  std::uint64_t malformed_seen_ = 0;
  BenchTime last_release_{};
  bool any_handed_ = false;
};

}  // namespace rigor::packet_lidar
