#include "drivers/ouster/frame_stream.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace rigor::ouster {

using packet_lidar::Cloud;
using packet_lidar::HandCloud;
using packet_lidar::PacketClock;

namespace {

/// 146 years: differences of any two instants are instants' differences, too.
constexpr std::uint64_t kTimeMask = 0x3FFF'FFFF'FFFF'FFFF;

}  // namespace

FrameStream::FrameStream(const Metadata& metadata, const FrameStreamOptions& options)
    : metadata_(metadata),
      layout_(layout_of(metadata)),
      options_(options),
      beams_(metadata),
      clock_({options.time, nanoseconds(1),
              seconds_from(metadata.column_period_s() * metadata.columns_per_packet)}),
      column_period_(seconds_from(metadata.column_period_s())) {
  clock_.set_utc_offset(options.utc_offset);
  if (options.image)
    image_.emplace(metadata, *options.image);
  else
    points_.reserve(max_points(metadata));
  expect();
}

void FrameStream::expect() {
  expected_.assign(metadata_.slots(), 0);
  seen_.assign(metadata_.slots(), 0);
  for (std::uint32_t c = 0; c < metadata_.mode.columns; ++c)
    if (metadata_.window.has(c)) ++expected_[c / metadata_.columns_per_packet];
  expected_slots_ = first_slot_ = 0;
  for (const std::uint8_t n : expected_) expected_slots_ += n > 0;
  while (first_slot_ < expected_.size() && expected_[first_slot_] == 0) ++first_slot_;
}

bool FrameStream::adopt(const Metadata& metadata) {
  if (image_) {
    if (metadata.mode.columns != image_->width_px() || metadata.pixels_per_column != image_->height_px() ||
        !check_field(metadata.profile, image_->options().field))
      return false;
    image_.emplace(metadata, *options_.image);
  } else if (max_points(metadata) > points_.capacity()) {
    return false;
  }
  metadata_ = metadata;
  layout_ = layout_of(metadata);
  beams_ = BeamTable(metadata);
  column_period_ = seconds_from(metadata.column_period_s());
  clock_.reset();
  open_ = false;
  renewed_ = true;
  points_.clear();
  expect();
  return true;
}

std::size_t FrameStream::max_points(const Metadata& m) {
  return std::size_t{m.window_columns()} * m.pixels_per_column * (m.profile == Profile::dual ? 2 : 1);
}

void FrameStream::reset() {
  clock_.reset();
  counters_ = {};
  open_ = started_ = any_begun_ = renewed_ = false;
  points_.clear();
  sequence_ = lost_clouds_ = 0;
}

void FrameStream::begin(std::uint16_t frame_id, std::uint32_t slot) {
  // 1 for the frame that follows; more where some are missing.
  std::uint32_t step = 1;
  whole_ = slot == first_slot_;
  const bool anew = std::exchange(renewed_, false);
  if (started_ && !anew && static_cast<std::int16_t>(frame_id - frame_id_) > 0) {
    step = static_cast<std::uint16_t>(frame_id - frame_id_);
    whole_ = true;
  } else if (started_) {
    // The sensor counts anew. What it did not send meanwhile is not known: at least one.
    ++counters_.restarts;
    step = 2;
  }
  if (any_begun_) {
    sequence_ += step;
    lost_clouds_ += step - 1;
    counters_.frames_lost += step - 1;
  }
  started_ = open_ = true;
  any_begun_ = any_begun_ || whole_;
  frame_id_ = frame_id;
  std::fill(seen_.begin(), seen_.end(), std::uint8_t{0});
  seen_slots_ = columns_ = 0;
  timed_ = false;
  points_.clear();
  if (image_) image_->clear();
}

void FrameStream::close(const HandCloud& hand) {
  if (!std::exchange(open_, false)) return;
  if (!whole_) {
    lost_clouds_ += any_begun_;
    return;
  }
  ++counters_.frames;
  const std::uint32_t packets = expected_slots_ - std::min(seen_slots_, expected_slots_);
  const std::uint32_t columns = metadata_.window_columns() - std::min(columns_, metadata_.window_columns());
  counters_.packets_lost += packets;
  counters_.columns_lost += columns;
  if (!timed_) {  // not one good column
    ++lost_clouds_;
    return;
  }
  const PacketClock::Placed at = clock_.place(t_begin_);
  Cloud c;
  c.points = points_;
  if (image_) c.pixels = image_->bytes();
  c.t_capture = at.t;
  c.sigma = at.sigma;
  c.sequence = sequence_;
  c.lost_before = std::exchange(lost_clouds_, 0);
  c.packets_lost = packets;
  if (columns > 0) c.validity |= kIncomplete;
  if (!at.known) c.validity |= kClockUnsure;
  hand(c);
}

void FrameStream::finish(const HandCloud& hand) { close(hand); }

void FrameStream::take(Bytes datagram, BenchTime arrival, const HandCloud& hand) {
  PacketFault fault{};
  const auto packet = LidarPacket::parse(datagram, layout_, fault);
  if (!packet) {
    ++counters_.malformed;
    counters_.last_fault = fault;
    return;
  }
  if (metadata_.initialization_id != 0 && packet->initialization_id() != metadata_.initialization_id &&
      layout_.profile != Profile::legacy) {
    ++counters_.other_initialization;
    if (options_.this_initialization_only) return;
  }
  ++counters_.packets;

  // All columns of a packet are of one slot; those that are not good may say nothing.
  std::uint32_t good = layout_.columns;
  for (std::uint32_t i = layout_.columns; i-- > 0;)
    if (packet->column(i).good()) good = i;
  if (good == layout_.columns) return;  // nothing in it: columns that are missing are counted by their frame
  const auto first = packet->column(good);
  const std::uint32_t slot = first.measurement_id() / layout_.columns;

  const DeviceTime t(static_cast<std::int64_t>(first.timestamp_ns() & kTimeMask));
  const std::uint16_t frame = packet->frame_id();
  const auto ahead = static_cast<std::int16_t>(frame - frame_id_);
  const Duration turn = column_period_ * static_cast<std::int64_t>(layout_.columns_per_frame);
  if (started_ && (renewed_ || ahead < -1 || t_last_ - t > turn * 3)) {
    // The sensor started anew, and so did its clock. What is at hand is placed by the old one.
    if (open_) close(hand);
    clock_.reset();
    renewed_ = true;
  }
  t_last_ = t;
  if (!clock_.observe(t, column_period_ * static_cast<std::int64_t>(layout_.columns - good), arrival))
    ++counters_.clock_steps;

  if (started_ && !renewed_ && (ahead == -1 || (ahead == 0 && !open_))) {
    ++counters_.packets_late;
    return;
  }
  if (open_ && ahead != 0) close(hand);
  if (!open_) begin(frame, slot);
  if (seen_[slot] != 0) {
    ++counters_.packets_late;
    return;
  }
  add(*packet, slot);
  if (seen_slots_ == expected_slots_) close(hand);
}

void FrameStream::add(const LidarPacket& packet, std::uint32_t slot) {
  seen_[slot] = 1;
  seen_slots_ += expected_[slot] > 0;
  for (std::uint32_t i = 0; i < layout_.columns; ++i) {
    const auto column = packet.column(i);
    if (!column.good()) continue;
    const std::uint32_t m = column.measurement_id();
    if (!metadata_.window.has(m) || m / layout_.columns != slot) continue;
    ++columns_;
    const DeviceTime t(static_cast<std::int64_t>(column.timestamp_ns() & kTimeMask));
    if (!std::exchange(timed_, true)) {
      // Where the columns before this one are missing, by their period. A window over the end of the turn
      // begins with its columns from 0 on.
      const std::uint32_t first =
          metadata_.window.first <= metadata_.window.last ? metadata_.window.first : 0;
      t_begin_ = t - seconds_from(metadata_.column_period_s() * (m - first));
    }
    if (image_) {
      for (std::uint32_t row = 0; row < layout_.pixels; ++row)
        image_->set(m, row, column.pixel(row), column.near_infrared(row));
      continue;
    }
    add_points(column, static_cast<std::int32_t>(std::clamp<std::int64_t>(
                           (t - t_begin_).ns(), std::numeric_limits<std::int32_t>::min(),
                           std::numeric_limits<std::int32_t>::max())));
  }
}

void FrameStream::add_points(const LidarPacket::Column& column, std::int32_t t_offset_ns) {
  const std::uint32_t m = column.measurement_id(), returns = layout_.dual() ? 2 : 1;
  for (std::uint32_t row = 0; row < layout_.pixels; ++row)
    for (std::uint32_t index = 0; index < returns; ++index) {
      const Pixel pixel = column.pixel(row, index);
      if (pixel.range_mm == 0 || points_.size() == points_.capacity()) continue;
      const BeamTable::Point p = beams_.at(m, row, pixel.range_mm * 1e-3);
      const std::uint16_t remission = options_.remission == Field::reflectivity ? pixel.reflectivity
                                      : options_.remission == Field::signal     ? pixel.signal
                                                                                : column.near_infrared(row);
      points_.push_back({p.x_m, p.y_m, p.z_m, static_cast<float>(remission), t_offset_ns,
                         static_cast<std::uint16_t>(row), static_cast<std::uint8_t>(index), 0});
    }
}

}  // namespace rigor::ouster
