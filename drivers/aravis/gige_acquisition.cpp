// Exposures of the emulated camera: free running, by software and by its input line; blocks; chunk data.
#include <algorithm>
#include <bit>
#include <utility>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {
std::uint64_t GigeDeviceModel::ticks(DeviceTime t) const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, (t - timestamp_zero_).ns()));
}

Period GigeDeviceModel::period() const {
  // Exposure and readout overlap, as in a global-shutter sensor: the longer of the two times sets the rate.
  const double rate = frame_rate_enable_ != 0 ? frame_rate_hz_ : config_.max_frame_rate_hz;
  const Period frame = Period::of_hz(rate), exposure = seconds_from(exposure_us_ * 1e-6);
  return exposure > frame ? exposure : frame;
}

void GigeDeviceModel::start_acquisition(DeviceTime now) {
  acquiring_ = true;
  ++epoch_;
  index_ = 0;
  triggers_.clear();
  frames_left_.reset();
  if (mode_ == reg::kModeSingleFrame) frames_left_ = 1;
  if (mode_ == reg::kModeMultiFrame) frames_left_ = frame_count_;
  sensor_free_ = now;
  run_freely_from(on_grid(now));
  rewire(now);
}

DeviceTime GigeDeviceModel::on_grid(DeviceTime t) const {
  if (!config_.align_to_clock) return t;
  const Period p = period();
  return DeviceTime(0) + p * p.first_index_from(t - DeviceTime(0));
}

void GigeDeviceModel::run_freely_from(DeviceTime t) {
  free_run_ = period();
  // On the emulator's grid the count goes on from its beginning.
  free_run_zero_ = config_.align_to_clock ? DeviceTime(0) : t;
  free_run_index_ = free_run_.nearest_index(t - free_run_zero_);
  next_free_run_ = t;
}

void GigeDeviceModel::stop_acquisition() {
  acquiring_ = false;
  ++epoch_;
  triggers_.clear();
}

GvStatus GigeDeviceModel::software_trigger(DeviceTime now) {
  if (!acquiring_ || trigger_mode_ == 0 || trigger_source_ != reg::kTriggerSourceSoftware) {
    ++counters_.triggers_refused;
    return GvStatus::access_denied;
  }
  if (triggers_.size() >= config_.trigger_queue) {
    ++counters_.triggers_refused;
    return GvStatus::busy;
  }
  ++counters_.triggers;
  triggers_.push_back(now + trigger_delay());
  return GvStatus::success;
}

// The line. A pulse is taken when it comes, or missed: there is no queue behind a wire.

DeviceTime GigeDeviceModel::wired_edge(DeviceTime t) const {
  return config_.line_period.ns() == 0 ? DeviceTime::never() : wired_at(wired_index(t));
}

std::int64_t GigeDeviceModel::wired_index(DeviceTime t) const {
  return (t - wired_at(0) - nanoseconds(1)) / config_.line_period + 1;
}

DeviceTime GigeDeviceModel::wired_at(std::int64_t k) const {
  const std::int64_t p = config_.line_period.ns();
  const std::int64_t first =
      config_.line_phase.ns() % p + (trigger_activation_ == reg::kFallingEdge ? p / 2 : 0);
  return DeviceTime(first) + config_.line_period * k;
}

void GigeDeviceModel::rewire(DeviceTime now) {
  next_wired_ = acquiring_ && on_line() ? wired_edge(now) : DeviceTime::never();
}

bool GigeDeviceModel::line_high(DeviceTime t) const {
  if (t >= pulse_rise_ && t < pulse_fall_) return true;
  const Period& p = config_.line_period;
  if (p.ns() == 0) return false;
  const Duration since = t - (DeviceTime(0) + config_.line_phase);
  return since - p * (since / p) < p / 2;
}

void GigeDeviceModel::pulse_line(DeviceTime rise, DeviceTime fall) {
  pulse_rise_ = rise, pulse_fall_ = fall;
  if (!acquiring_ || !on_line()) return;
  const DeviceTime start = (trigger_activation_ == reg::kRisingEdge ? rise : fall) + trigger_delay();
  if (start < sensor_free_ || triggers_.size() >= config_.trigger_queue) {
    ++counters_.line_missed;
    return;
  }
  triggers_.push_back(start);
}

/// Edges and actions that came while the sensor was busy.
void GigeDeviceModel::miss_edges() {
  for (; !triggers_.empty() && triggers_.front() < sensor_free_; triggers_.pop_front())
    ++(on_action() ? counters_.actions_missed : counters_.line_missed);
  if (next_wired_ == DeviceTime::never()) return;
  const DeviceTime free = sensor_free_ - trigger_delay();
  if (free <= next_wired_) return;
  counters_.line_missed += static_cast<std::uint64_t>(wired_index(free) - wired_index(next_wired_));
  next_wired_ = wired_edge(free);
}

// Actions. Like a pulse on a wire, one is taken when its time has come, or missed.

std::optional<GvStatus> GigeDeviceModel::act(const ActionCmd& c, DeviceTime now) {
  const bool listens = privilege_ != 0 || (gvcp_configuration_ & reg::kUnconditionalAction) != 0;
  if (!listens || c.device_key != action_device_key_ || c.group_key != action_group_key_ ||
      (c.group_mask & action_group_mask_) == 0)
    return std::nullopt;
  ++counters_.actions;
  if (!c.time_ticks) {
    assert_action(now);
    return GvStatus::success;
  }
  const auto refuse = [this](GvStatus why) { return ++counters_.actions_refused, why; };
  // A time means something on a clock that others share.
  if (ptp_status(now) != reg::kPtpSlave) return refuse(GvStatus::no_reference_time);
  if (*c.time_ticks <= ticks(now)) {
    ++counters_.actions_late;
    assert_action(now);
    return GvStatus::action_late;
  }
  constexpr Duration kFarthest = seconds(10LL * 365 * 86400);
  if (*c.time_ticks - ticks(now) > static_cast<std::uint64_t>(kFarthest.ns()))
    return refuse(GvStatus::invalid_parameter);
  if (actions_.size() >= kActionQueue) return refuse(GvStatus::overflow);
  const DeviceTime t = timestamp_zero_ + nanoseconds(static_cast<std::int64_t>(*c.time_ticks));
  actions_.insert(std::upper_bound(actions_.begin(), actions_.end(), t), t);
  return GvStatus::success;
}

void GigeDeviceModel::run_actions(DeviceTime now) {
  for (; !actions_.empty() && actions_.front() <= now; actions_.pop_front()) assert_action(actions_.front());
}

void GigeDeviceModel::assert_action(DeviceTime t) {
  if (!acquiring_ || !on_action()) return;
  if (t + trigger_delay() < sensor_free_ || triggers_.size() >= config_.trigger_queue)
    ++counters_.actions_missed;
  else
    triggers_.push_back(t + trigger_delay());
}

// IEEE 1588: a servo that has settled keeps the clock within the offset, this way and that.

std::uint32_t GigeDeviceModel::ptp_status(DeviceTime now) const {
  if (!ptp_enabled_) return reg::kPtpDisabled;
  const Duration since = now - ptp_since_;
  if (since >= config_.ptp.settle) return reg::kPtpSlave;
  return since * 2 >= config_.ptp.settle ? reg::kPtpUncalibrated : reg::kPtpListening;
}

std::int64_t GigeDeviceModel::ptp_offset_ns(DeviceTime now) const {
  if (ptp_status(now) != reg::kPtpSlave) return 0;
  // A triangle of 16 s between −offset and +offset.
  const std::int64_t most = config_.ptp.offset.ns(), quarter = seconds(4).ns();
  const std::int64_t at = (now - ptp_since_).ns() % (4 * quarter);
  const auto part =
      static_cast<double>(at < 2 * quarter ? at - quarter : 3 * quarter - at) / static_cast<double>(quarter);
  return static_cast<std::int64_t>(part * static_cast<double>(most));
}

// Chunk data.

std::size_t GigeDeviceModel::frame_bytes() const {
  const auto picture = static_cast<std::size_t>(payload_bytes(region_, format_));
  return config_.range.present ? picture * (unsigned{sends_range()} + unsigned{sends_amplitude()}) : picture;
}

void GigeDeviceModel::describe_parts(const FrameRequest& r, GvspLeader& leader) const {
  leader.payload_type = kMultipartPayload;
  leader.part_count = 0;
  const auto add = [&](std::uint16_t type, std::uint16_t purpose, PixelFormat format) {
    leader.parts[leader.part_count++] = {type, purpose, payload_bytes(region_, format), format, region_};
  };
  if (r.range) add(kPart3d, kRange, PixelFormat::coord3d_c16);
  if (r.amplitude) add(kPart2d, kIntensity, PixelFormat::mono16);
}

std::size_t GigeDeviceModel::chunk_bytes() const {
  if (chunk_mode_ == 0 || multipart_) return 0;
  return reg::kChunkTrailer + static_cast<std::size_t>(std::popcount(chunks_ & ~(1u << reg::kChunkImage))) *
                                  (reg::kChunkValue + reg::kChunkTrailer);
}

void GigeDeviceModel::append_chunks(const FrameRequest& r, std::vector<std::uint8_t>& data) const {
  if (chunk_mode_ == 0 || multipart_) return;
  for (const Chunk& chunk : chunk_table()) {
    std::size_t length = data.size();
    if (chunk.id != reg::kChunkImage) {
      if (((chunks_ >> chunk.id) & 1) == 0) continue;
      append_be(data, chunk.value(r));
      length = reg::kChunkValue;
    }
    append_be(data, chunk.id);
    append_be(data, static_cast<std::uint32_t>(length));
  }
}

DeviceTime GigeDeviceModel::next_exposure() const {
  if (!acquiring_) return DeviceTime::never();
  if (trigger_mode_ == 0) return next_free_run_;
  DeviceTime asked = triggers_.empty() ? DeviceTime::never() : std::max(triggers_.front(), sensor_free_);
  if (on_action() && !actions_.empty()) asked = std::min(asked, actions_.front() + trigger_delay());
  return next_wired_ == DeviceTime::never() ? asked : std::min(asked, next_wired_ + trigger_delay());
}

std::shared_ptr<GvspBlock> GigeDeviceModel::new_block() {
  for (auto& b : pool_) {
    if (b.use_count() == 1) return b;
  }
  pool_.push_back(std::make_shared<GvspBlock>());
  return pool_.back();
}

bool GigeDeviceModel::begin_frame(DeviceTime now, FrameJob& job) {
  run_actions(now);
  DeviceTime start = next_exposure();
  if (start > now) return false;
  if (trigger_mode_ == 0) {
    if (!free_run_.same_as(period())) {  // what sets the rate was written since
      free_run_ = period();
      free_run_zero_ = start;
      free_run_index_ = 0;
    }
    const std::int64_t behind = (now - free_run_zero_) / free_run_ - free_run_index_;
    if (behind > 0) {
      counters_.exposures_skipped += static_cast<std::uint64_t>(behind);
      index_ += static_cast<std::uint64_t>(behind);
      free_run_index_ += behind;
      start = free_run_zero_ + free_run_ * free_run_index_;
    }
    next_free_run_ = free_run_zero_ + free_run_ * ++free_run_index_;
  } else if (next_wired_ != DeviceTime::never() && next_wired_ + trigger_delay() == start) {
    // Edges that nobody came to look at in time are past.
    const std::int64_t newest = wired_index(now - trigger_delay() + nanoseconds(1)) - 1;
    const std::int64_t behind = newest - wired_index(next_wired_);
    counters_.exposures_skipped += static_cast<std::uint64_t>(behind);
    index_ += static_cast<std::uint64_t>(behind);
    start = wired_at(newest) + trigger_delay();
    next_wired_ = wired_at(newest + 1);
    ++counters_.line_edges;
  } else {
    triggers_.pop_front();
    if (on_line()) ++counters_.line_edges;
  }
  const Duration exposure = seconds_from(exposure_us_ * 1e-6);
  sensor_free_ = start + exposure;
  if (on_line() || on_action()) miss_edges();
  job.request = {index_++, start,   ticks(start),  exposure,         gain_db_,
                 region_,  format_, sends_range(), sends_amplitude()};
  job.t_send = start + exposure + config_.readout;
  job.epoch = epoch_;
  job.block = new_block();
  job.block->data.resize(frame_bytes());
  job.block->packet_size = packet_size_;
  const auto kind = chunk_mode_ != 0 ? kImagePayload | kChunkFlag : kImagePayload;
  job.block->leader = {static_cast<std::uint16_t>(kind), job.request.timestamp_ticks, format_, region_, 0, 0};
  job.block->extended_ids = multipart_;
  if (multipart_) describe_parts(job.request, job.block->leader);
  return true;
}

std::optional<OutgoingBlock> GigeDeviceModel::finish_frame(FrameJob&& job, bool filled) {
  const auto block = std::move(job.block);
  if (!acquiring_ || job.epoch != epoch_ || block == nullptr) return std::nullopt;
  if (!filled) {
    ++counters_.pictures_missing;
    return std::nullopt;
  }
  if (frames_left_ && --*frames_left_ == 0) {
    acquiring_ = false;
    triggers_.clear();
  }
  if (stream_port_ == 0) return std::nullopt;
  append_chunks(job.request, block->data);
  ++counters_.frames;
  block->block_id = next_block_id_;
  next_block_id_ = next_block_id_ == 0xFFFF && !block->extended_ids ? 1 : next_block_id_ + 1;
  retained_.push_back(block);
  while (retained_.size() > config_.retained_frames) retained_.pop_front();
  return OutgoingBlock{block, job.t_send, stream_destination(), nanoseconds(packet_delay_ticks_)};
}

}  // namespace rigor::gige
