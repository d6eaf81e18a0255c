#include "drivers/lidar/sensor_source.h"

namespace rigor::packet_lidar {

void SensorSource::open_readings(std::size_t buffers, Feed feed) {
  feed_ = feed;
  in_run_.reset();
  last_reading_release_ = {};
  open_clouds(buffers, 0, feed);  // readings lie in their info alone
}

void SensorSource::hand_reading(const Reading& r) noexcept {
  RunSequence::Place place{r.sequence, r.lost_before};
  if (feed_ == Feed::live) {
    const auto in_run = in_run_.place(origin(), r.t_capture, config().period, r.sequence, r.lost_before);
    if (!in_run) return;
    place = *in_run;
  }
  if (place.lost > 0) count_lost(place.lost);
  SampleSlot slot = take_slot();
  last_reading_release_ = r.t_capture + config().latency;
  if (slot) {
    Sample& s = *slot;
    s.size_bytes = 0;
    s.info = r.imu;
    s.stamp = {};
    s.stamp.sequence = place.sequence;
    s.stamp.t_capture = r.t_capture;
    s.stamp.t_release = last_reading_release_;
    s.stamp.t_arrival = feed_ == Feed::virtual_time ? last_reading_release_ : bench_now();
    s.stamp.sigma_capture = r.sigma;
    s.stamp.validity = r.validity;
  }
  hand_over(std::move(slot));
}

}  // namespace rigor::packet_lidar
