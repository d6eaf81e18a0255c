#include "drivers/lidar/sensor_source.h"

#include <algorithm>
#include <cstring>

namespace rigor::packet_lidar {

void SensorSource::open_clouds(std::size_t buffers, std::size_t max_points, Feed feed) {
  image_ = {};
  open(buffers, max_points * sizeof(LidarPoint), feed);
}

void SensorSource::open_images(std::size_t buffers, const decltype(Sample::info)& info, std::size_t bytes,
                               Feed feed) {
  image_ = info;
  if (const auto* image = std::get_if<ImageInfo>(&info)) {
    description_.width_px = image->width_px, description_.height_px = image->height_px;
    description_.format = image->format;
  } else if (const auto* range = std::get_if<RangeImageInfo>(&info)) {
    description_.width_px = range->width_px, description_.height_px = range->height_px;
  }
  open(buffers, bytes, feed);
}

void SensorSource::open(std::size_t buffers, std::size_t bytes, Feed feed) {
  description_.max_bytes = bytes;
  feed_ = feed;
  in_run_.reset();
  malformed_seen_ = 0;
  any_handed_ = false;
  last_release_ = {};
  open_stream(buffers, description_.max_bytes, feed == Feed::virtual_time);
}

void SensorSource::count_malformed(std::uint64_t malformed) noexcept {
  if (malformed == malformed_seen_) return;
  health_.protocol_errors.fetch_add(malformed - malformed_seen_, std::memory_order_relaxed);
  malformed_seen_ = malformed;
}

template <class From, class Fill>
void SensorSource::hand_sample(const From& from, const Fill& fill) noexcept {
  RunSequence::Place place{from.sequence, from.lost_before};
  if (feed_ == Feed::live) {
    const auto in_run =
        in_run_.place(origin(), from.t_capture, config().period, from.sequence, from.lost_before);
    if (!in_run) return;
    place = *in_run;
  }
  if (place.lost > 0) count_lost(place.lost);
  SampleSlot slot = take_slot();
  last_release_ = from.t_capture + config().latency;
  any_handed_ = true;
  if (slot) {
    Sample& s = *slot;
    fill(s);
    s.stamp = {};
    s.stamp.sequence = place.sequence;
    s.stamp.t_capture = from.t_capture;
    s.stamp.t_release = last_release_;
    s.stamp.t_arrival = feed_ == Feed::virtual_time ? last_release_ : bench_now();
    s.stamp.sigma_capture = from.sigma;
    s.stamp.validity = from.validity;
    if ((from.validity & kIncomplete) != 0) health_.incomplete.fetch_add(1, std::memory_order_relaxed);
  }
  hand_over(std::move(slot));
}

void SensorSource::hand_cloud(const Cloud& c) noexcept {
  hand_sample(c, [&](Sample& s) {
    if (std::holds_alternative<std::monostate>(image_)) {
      const std::size_t room = s.memory().size() / sizeof(LidarPoint);
      const std::size_t count = std::min(c.points.size(), room);
      s.size_bytes = count * sizeof(LidarPoint);
      if (count > 0) std::memcpy(s.memory().data(), c.points.data(), s.size_bytes);
      s.info = PointCloudInfo{static_cast<std::uint32_t>(count)};
    } else {
      s.size_bytes = std::min(c.pixels.size(), s.memory().size());
      if (s.size_bytes > 0) std::memcpy(s.memory().data(), c.pixels.data(), s.size_bytes);
      s.info = image_;
    }
  });
}

void SensorSource::hand_reading(const Reading& r) noexcept {
  hand_sample(r, [&](Sample& s) {
    s.size_bytes = 0;  // a reading lies in its info
    s.info = r.imu;
  });
}

}  // namespace rigor::packet_lidar
