#include "drivers/livox/point_stream.h"

#include <algorithm>
#include <utility>

namespace rigor::livox {
namespace {

constexpr std::int64_t kPacket_ns = kPoint_ns * kDots;
constexpr std::int64_t kAway_ns = 10'000'000'000, kOvertaken_ns = 20'000'000, kHeldUp_ns = 500'000'000;

}  // namespace

PointStream::PointStream(const PointStreamOptions& options)
    : options_(options), clock_({options.time, nanoseconds(1), Duration(kPacket_ns)}) {
  // At the device's rate, and a little more: its clock is not the bench's.
  max_points_ = static_cast<std::size_t>(options.frame.ns() / kPoint_ns * 102 / 100) + std::size_t{2} * kDots;
  points_.reserve(max_points_);
}

void PointStream::reset() {
  clock_.reset();
  counters_ = {};
  forget();
  sequence_ = lost_clouds_ = 0;
  time_type_ = TimeType::none;
}

void PointStream::forget() {
  any_packet_ = open_ = started_ = last_handed_ = false;
  lost_from_ = lost_to_ = {};
  points_.clear();
}

/// Whether a packet goes on where the last one ended, however much later. Counts what is missing in between.
bool PointStream::in_order(const Packet& packet, DeviceTime t, BenchTime arrival) {
  bool set = std::exchange(time_type_, packet.time_type()) != packet.time_type();
  if (!any_packet_) return true;
  const std::int64_t step = (t - t_last_).ns();
  // Later than its clock says: it was switched off meanwhile. (Its clock may be anywhere then.)
  set = set || (arrival - t_last_arrival_).ns() - step > kHeldUp_ns;
  const std::uint16_t ahead = static_cast<std::uint16_t>(packet.udp_count() - last_count_);
  if (!set && step <= 0 && step > -kOvertaken_ns && (ahead == 0 || ahead > 0x8000)) {
    ++counters_.packets_late;
    return false;
  }
  if (set || step <= 0) {
    // What a device that goes back has lost is not known: the frame that was begun, or would have been next.
    ++counters_.clock_steps;
    if (started_) {
      sequence_ += open_ ? 1 : 2;
      ++lost_clouds_;
    }
    forget();
    clock_.reset();
    return true;
  }
  const std::int64_t by_time = std::max<std::int64_t>(0, (step + filled_ns_ / 2) / filled_ns_ - 1);
  const std::int64_t by_count = static_cast<std::uint16_t>(ahead - 1);
  const std::int64_t differ = by_count > by_time ? by_count - by_time : by_time - by_count;
  const std::int64_t lost = step > kAway_ns || differ > 2 + by_time / 16 ? by_time : by_count;
  if (lost > 0) lose(static_cast<std::uint64_t>(lost), t_last_ + Duration(filled_ns_), t);
  return true;
}

void PointStream::lose(std::uint64_t packets, DeviceTime from, DeviceTime to) {
  counters_.packets_lost += packets;
  lost_from_ = from, lost_to_ = to;
  if (!open_) return;
  // As many of them as the frame at hand has left.
  const std::int64_t rest = std::max<std::int64_t>(0, (frame_ + 1) * options_.frame.ns() - from.ns());
  const std::int64_t inside =
      std::min<std::int64_t>(static_cast<std::int64_t>(packets), (rest + filled_ns_ - 1) / filled_ns_);
  lost_inside_ += static_cast<std::uint32_t>(inside);
  incomplete_ = incomplete_ || inside > 0;
}

void PointStream::begin(std::int64_t frame, DeviceTime first) {
  const std::int64_t begin_ns = frame * options_.frame.ns();
  if (started_) {
    const std::int64_t steps = std::max<std::int64_t>(1, frame - frame_);
    sequence_ += static_cast<std::uint64_t>(steps);
    lost_clouds_ += static_cast<std::uint64_t>(steps - (last_handed_ ? 1 : 0));
  }
  whole_ = started_ || first.ns() - begin_ns < 2 * kPoint_ns;
  started_ = started_ || whole_;
  open_ = true;
  last_handed_ = false;
  frame_ = frame;
  points_.clear();
  // Packets that are missing may be of its beginning.
  const std::int64_t missing =
      lost_to_ > lost_from_ ? lost_to_.ns() - std::max(lost_from_.ns(), begin_ns) : 0;
  lost_inside_ =
      missing > 0
          ? static_cast<std::uint32_t>((missing + filled_ns_ / 2) / std::max<std::int64_t>(1, filled_ns_))
          : 0;
  incomplete_ = missing >= 2 * kPoint_ns;
  lost_from_ = lost_to_ = {};
}

void PointStream::take(Bytes datagram, BenchTime arrival, const packet_lidar::HandCloud& hand) {
  PacketFault fault{};
  const auto packet = Packet::parse(datagram, fault);
  if (!packet || packet->data_type() == DataType::imu) {
    ++counters_.malformed;
    counters_.last_fault = packet ? PacketFault::wrong_type : fault;
    return;
  }
  ++counters_.packets;
  data_type_ = packet->data_type();
  // Three centuries; more is no time.
  const DeviceTime t(static_cast<std::int64_t>(packet->timestamp_ns() & 0x3FFF'FFFF'FFFF'FFFF));
  if (!in_order(*packet, t, arrival)) return;
  const std::uint32_t dots = packet->dots();
  filled_ns_ =
      dots > 1 && packet->interval_ns() > 0 ? packet->interval_ns() * dots / (dots - 1) : kPoint_ns * dots;
  any_packet_ = true;
  t_last_ = t;
  t_last_arrival_ = arrival;
  last_count_ = packet->udp_count();
  if (options_.time == packet_lidar::TimeSource::utc)
    clock_.set_utc_offset(options_.utc_offset.value_or(utc_less(time_type_)));
  if (!clock_.observe(t, Duration(filled_ns_), arrival)) ++counters_.clock_steps;

  const std::int64_t frame_ns = options_.frame.ns();
  for (std::uint32_t i = 0; i < dots; ++i) {
    const std::int64_t at_ns = t.ns() + packet->offset_ns(i);
    const std::int64_t frame = at_ns / frame_ns;
    if (!open_ || frame != frame_) {
      close(hand);
      begin(frame, DeviceTime(at_ns));
    }
    const Point p = packet->point(i);
    if (!p.is_return()) continue;
    ++counters_.points;
    if (options_.drop_noise && (p.tag & 0x3F) != 0) {
      ++counters_.noise;
      continue;
    }
    if (points_.size() == max_points_) {
      ++counters_.points_dropped;
      incomplete_ = true;
      continue;
    }
    LidarPoint& to = points_.emplace_back();
    to.x_m = p.x_m, to.y_m = p.y_m, to.z_m = p.z_m;
    to.remission = p.reflectivity;
    to.t_offset_ns = static_cast<std::int32_t>(at_ns - frame * frame_ns);
    to.ring = static_cast<std::uint16_t>(i % kLines);
  }
  // With its last point a frame is over.
  if (open_ && t.ns() + filled_ns_ >= (frame_ + 1) * frame_ns) close(hand);
}

void PointStream::close(const packet_lidar::HandCloud& hand) {
  if (!std::exchange(open_, false) || !whole_) return;
  const packet_lidar::PacketClock::Placed at = clock_.place(DeviceTime(frame_ * options_.frame.ns()));
  packet_lidar::Cloud c;
  c.points = points_;
  c.t_capture = at.t;
  c.sigma = at.sigma;
  c.sequence = sequence_;
  c.lost_before = std::exchange(lost_clouds_, 0);
  c.packets_lost = lost_inside_;
  if (incomplete_) c.validity |= kIncomplete;
  // A device that was not set knows no UTC.
  if (!at.known || (options_.time == packet_lidar::TimeSource::utc && time_type_ == TimeType::none))
    c.validity |= kClockUnsure;
  ++counters_.frames;
  counters_.frames_incomplete += incomplete_;
  last_handed_ = true;
  hand(c);
}

}  // namespace rigor::livox
