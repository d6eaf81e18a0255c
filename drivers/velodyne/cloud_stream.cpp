#include "drivers/velodyne/cloud_stream.h"

#include <algorithm>
#include <cmath>

namespace rigor::velodyne {
namespace {

constexpr std::int64_t kHour_ns = 3'600'000'000'000;

PacketClock::Options clock_options(const DeviceFacts& f, TimeSource source) {
  // The packet goes out when its last laser has fired; less it cannot be. Dual packets take half as long, and
  // their excess is in sigma.
  return {source, microseconds(1), Duration(f.packet_ns(false))};
}

}  // namespace

CloudStream::CloudStream(PacketDecoder decoder, const CloudStreamOptions& options)
    : decoder_(std::move(decoder)),
      options_(options),
      clock_(clock_options(decoder_.facts(), options.time)),
      revolution_(options.revolution) {
  points_.reserve(options_.max_points);
}

void CloudStream::reset() {
  hour_.reset();
  clock_.reset();
  evidence_ = {};
  counters_ = {};
  product_ = mode_ = 0;
  any_packet_ = open_ = any_begun_ = last_handed_ = false;
  points_.clear();
  sequence_ = lost_clouds_ = 0;
  lost_inside_ = 0;
  revolution_ = options_.revolution;
}

/// Ties the device's time to the bench's by one more packet.
void CloudStream::observe(DeviceTime t, std::uint32_t us, BenchTime arrival, Duration filled) {
  if (clock_.source() == TimeSource::utc) {
    // The hour in which this packet is nearest to its arrival.
    const std::int64_t utc = (clock_.epoch().to_utc(arrival) - filled).ns(),
                       in_hour = std::int64_t{us} * 1000;
    const std::int64_t hour = ((utc - in_hour) + kHour_ns / 2) / kHour_ns;
    clock_.set_utc_offset(Duration(hour * kHour_ns - (t.ns() - in_hour)));
  }
  if (!clock_.observe(t, filled, arrival)) ++counters_.clock_steps;
}

void CloudStream::take(Bytes datagram, BenchTime arrival, const HandCloud& hand) {
  PacketFault fault{};
  const auto packet = DataPacket::parse(datagram, fault);
  if (!packet) {
    ++counters_.malformed;
    counters_.last_fault = fault;
    return;
  }
  ++counters_.packets;
  counters_.full_turns += packet->says_full_turn();
  evidence_.add(*packet);
  product_ = packet->product(), mode_ = static_cast<std::uint8_t>(packet->mode());
  const std::int64_t packet_ns = decoder_.facts().packet_ns(packet->dual());
  const DeviceTime t = hour_.unwrap(packet->timestamp_us());

  if (any_packet_) {
    const std::int64_t step = (t - t_last_packet_).ns();
    if (step <= 0 || step > 10'000'000'000) {
      // Set anew, or away for long: nothing that was begun goes on. What a device that goes back has lost is
      // not known.
      if (step <= 0) {
        ++counters_.clock_steps;
        any_begun_ = false;
        ++sequence_;
        ++lost_clouds_;
      } else {
        counters_.packets_lost += static_cast<std::uint64_t>(step / packet_ns - 1);
      }
      open_ = false;
      points_.clear();
      lost_inside_ = 0;
    } else if (step > packet_ns + packet_ns / 2) {
      const auto lost = static_cast<std::uint64_t>((step + packet_ns / 2) / packet_ns - 1);
      counters_.packets_lost += lost;
      lost_inside_ += static_cast<std::uint32_t>(lost);
      // Half a turn and more: where this revolution ended cannot be told.
      if (options_.unit == CloudUnit::revolution && step > revolution_.ns() / 2) {
        open_ = false;
        points_.clear();
      }
    }
  }
  any_packet_ = true;
  t_last_packet_ = t;
  observe(t, packet->timestamp_us(), arrival, Duration(packet_ns));
  decoder_.decode(*packet, decoded_);

  if (options_.unit == CloudUnit::packet) {
    begin(t, true);
    for (std::uint32_t i = 0; i < decoded_.sequence_count; ++i) add(decoded_.sequences[i], t);
    lost_inside_ = 0;
    finish(hand);
    return;
  }
  for (std::uint32_t i = 0; i < decoded_.sequence_count; ++i) {
    const DecodedPacket::Sequence& s = decoded_.sequences[i];
    double turn = s.azimuth_cdeg - options_.cut_cdeg;
    if (turn < 0) turn += kTurn_cdeg;
    const bool cut = open_ && turn < last_turn_cdeg_ - kTurn_cdeg / 2;
    if (cut) finish(hand);
    if (cut || !open_) {
      // A stream that sets in within the first sequence after the cut lacks nothing.
      const double step = decoded_.sequences[1].azimuth_cdeg - decoded_.sequences[0].azimuth_cdeg;
      begin(t + Duration(s.offset_ns), cut || (i == 0 && turn < step));
    }
    last_turn_cdeg_ = turn;
    add(s, t);
  }
}

void CloudStream::begin(DeviceTime t, bool whole) {
  open_ = true;
  whole_ = whole;
  truncated_ = false;
  t_begin_ = t;
  points_.clear();
  if (!whole) return;
  if (any_begun_) {
    const std::int64_t period =
        options_.unit == CloudUnit::packet
            ? decoder_.facts().packet_ns(mode_ == static_cast<std::uint8_t>(ReturnMode::dual))
            : revolution_.ns();
    const std::int64_t elapsed = (t - t_last_begin_).ns();
    const std::int64_t steps = std::max<std::int64_t>(1, (elapsed + period / 2) / period);
    sequence_ += static_cast<std::uint64_t>(steps);
    lost_clouds_ += static_cast<std::uint64_t>(steps - (last_handed_ ? 1 : 0));
    // Rotors are set between 5 and 20 Hz.
    if (options_.unit == CloudUnit::revolution && steps == 1 && elapsed > 40'000'000 && elapsed < 250'000'000)
      revolution_ = Duration(elapsed);
  }
  any_begun_ = true;
  last_handed_ = false;
  t_last_begin_ = t;
}

void CloudStream::add(const DecodedPacket::Sequence& s, DeviceTime t_packet) {
  const std::int64_t shift = (t_packet - t_begin_).ns();
  for (std::uint32_t i = s.first; i < s.first + s.count; ++i) {
    if (options_.max_points > 0 && points_.size() >= options_.max_points) {
      counters_.points_dropped += s.first + s.count - i;
      truncated_ = true;
      return;
    }
    LidarPoint& p = points_.emplace_back(decoded_.points[i]);
    p.t_offset_ns = static_cast<std::int32_t>(p.t_offset_ns + shift);
  }
}

void CloudStream::finish(const HandCloud& hand) {
  open_ = false;
  const std::uint32_t lost = std::exchange(lost_inside_, 0);
  if (!whole_) return;
  const PacketClock::Placed at = clock_.place(t_begin_);
  Cloud c;
  c.points = points_;
  c.t_capture = at.t;
  c.sigma = at.sigma;
  c.sequence = sequence_;
  c.lost_before = std::exchange(lost_clouds_, 0);
  c.packets_lost = lost;
  if (lost > 0 || truncated_) c.validity |= kIncomplete;
  if (!at.known) c.validity |= kClockUnsure;
  last_handed_ = true;
  hand(c);
}

}  // namespace rigor::velodyne
