// What sources of packet LiDARs share: what a device's stream gives becomes samples of a channel. The kind of
// the channel decides what that is: point clouds, images of the same packets, or readings of the inertial
// unit that sits in the device.
//
//   do_arm    open_clouds(buffers, max_points, Feed::live), open_images(…) or open_readings(…)
//   thread    stream.take(datagram, arrival, hand())          // calls hand_cloud for each cloud
//             hand_reading(reading)
//   do_stop   join the thread, then close_stream()
#pragma once

#include <functional>

#include "drivers/lidar/cloud.h"
#include "drivers/lidar/reading_stream.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::packet_lidar {

class SensorSource : public StreamSource {
 protected:
  /// Where the packets come from: a device that measures since before the run; packets of a recording, which
  /// begins with the run; either in virtual time.
  enum class Feed : std::uint8_t { live, recording, virtual_time };
  /// Setup: memory for clouds of up to `max_points`.
  void open_clouds(std::size_t buffers, std::size_t max_points, Feed feed);
  /// Setup: memory for images of `bytes` each; `info`: what each of them is (ImageInfo, RangeImageInfo).
  void open_images(std::size_t buffers, const decltype(Sample::info)& info, std::size_t bytes, Feed feed);
  /// Setup: memory for readings.
  void open_readings(std::size_t buffers, Feed feed) { open_clouds(buffers, 0, feed); }

  /// Producer thread.
  [[nodiscard]] const HandCloud& hand() const { return hand_; }
  void hand_reading(const Reading& reading) noexcept;
  /// Producer thread: how many datagrams were no packets so far; new ones are protocol errors.
  void count_malformed(std::uint64_t malformed) noexcept;
  [[nodiscard]] bool is_imu() const { return description_.kind == SampleKind::imu; }
  /// Producer thread, in virtual time: whether a sample was handed over that is released after `now`.
  [[nodiscard]] bool handed_past(BenchTime now) const { return any_handed_ && last_release_ > now; }

 private:
  void open(std::size_t buffers, std::size_t bytes, Feed feed);
  void hand_cloud(const Cloud& cloud) noexcept;
  /// Numbers a sample, stamps it, and gives it to the loop; `fill` writes its data. `from`: Cloud or Reading.
  template <class From, class Fill>
  void hand_sample(const From& from, const Fill& fill) noexcept;

  HandCloud hand_ = [this](const Cloud& c) { hand_cloud(c); };
  Feed feed_ = Feed::live;
  decltype(Sample::info) image_;  ///< of a channel of images
  RunSequence in_run_;
  std::uint64_t malformed_seen_ = 0;
  BenchTime last_release_{};
  bool any_handed_ = false;
};

}  // namespace rigor::packet_lidar
