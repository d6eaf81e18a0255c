#include "drivers/v4l2/emulated_capture.h"

#include <algorithm>
#include <cmath>

namespace rigor::v4l2 {
namespace {

constexpr std::int64_t kMaxExposure = 100'000;  // 10 s in units of 100 µs

}  // namespace

EmulatedCapture::EmulatedCapture(const EmulatedVideoSettings& settings, EmulatedPictures pictures)
    : settings_(settings), pictures_(std::move(pictures)) {
  period_ = Period::of_hz(settings.rate_hz);
  // Its control has units of 100 µs, so it exposes in whole ones.
  const std::int64_t units = std::max<std::int64_t>(1, (pictures_.exposure().ns() + 50'000) / 100'000);
  pictures_.set_exposure(microseconds(units * 100));
}

Result<DeviceTable> EmulatedCapture::table() {
  DeviceTable t;
  t.path = "(in process)", t.driver = "rigor", t.card = settings_.card, t.bus = "virtual";
  t.captures = t.streams = t.sets_rate = true;
  for (const std::uint32_t code : settings_.codes) {
    OfferedSize size;
    size.min_width_px = size.max_width_px = pictures_.width_px();
    size.min_height_px = size.max_height_px = pictures_.height_px();
    size.intervals = {{static_cast<std::uint32_t>(std::llround(1e7 / settings_.rate_hz)), 10'000'000}};
    t.formats.push_back({code, fourcc_text(code), {size}});
  }
  t.current_code = pictures_.code();
  t.current_width_px = pictures_.width_px(), t.current_height_px = pictures_.height_px();
  Control exposure;
  exposure.id = kExposureAbsolute;
  exposure.name = "exposure_time_absolute";
  exposure.minimum = 1, exposure.maximum = kMaxExposure;
  exposure.fallback = std::max<std::int64_t>(1, pictures_.exposure().ns() / 100'000);
  t.controls.push_back(exposure);
  return t;
}

Result<ActualFormat> EmulatedCapture::set_format(const FormatChoice& choice) {
  ActualFormat a;
  pictures_.set_code(choice.code);
  a.code = choice.code, a.width_px = pictures_.width_px(), a.height_px = pictures_.height_px();
  a.stride_bytes = frame_stride(choice.code, a.width_px);
  a.size_bytes = static_cast<std::uint32_t>(frame_bytes(choice.code, a.width_px, a.height_px));
  a.interval = {static_cast<std::uint32_t>(std::llround(1e7 / settings_.rate_hz)), 10'000'000};
  return a;
}

Status EmulatedCapture::set_control(std::uint32_t id, std::int64_t value) {
  if (id != kExposureAbsolute) return fail(ErrorCode::bad_input, settings_.card, "no such control");
  pictures_.set_exposure(microseconds(value * 100));
  return {};
}

Result<std::int64_t> EmulatedCapture::get_control(std::uint32_t id) {
  if (id != kExposureAbsolute) return fail(ErrorCode::bad_input, settings_.card, "no such control");
  return pictures_.exposure().ns() / 100'000;
}

Status EmulatedCapture::start(std::uint32_t count) {
  buffers_.assign(count, {});
  for (std::uint32_t i = 0; i < count; ++i) {
    buffers_[i].memory.resize(frame_bytes(pictures_.code(), pictures_.width_px(), pictures_.height_px()));
    buffers_[i].queued = true;
  }
  done_.clear();
  next_index_ = dropped_ = 0;
  running_ = true;
  return {};
}

void EmulatedCapture::set_grid(BenchTime t0, const Period& period) noexcept { t0_ = t0, period_ = period; }

bool EmulatedCapture::advance(BenchTime now) {
  const Shutter shutter{.exposure = pictures_.exposure(), .readout = settings_.readout};
  const Duration to_end = -event_to_capture(TimestampEvent::end_of_frame, shutter);
  const BenchTime t = t0_ + period_ * static_cast<std::int64_t>(next_index_);
  if (!running_ || t + to_end > now) return false;
  const std::uint64_t index = next_index_++;
  std::uint32_t free = 0;
  while (free < buffers_.size() && !buffers_[free].queued) ++free;
  if (free == buffers_.size()) {
    ++dropped_;
    return true;
  }
  Buffer& b = buffers_[free];
  b.used = pictures_.capture(index, t, t0_, b.memory);
  b.queued = false;
  b.frame = {.bytes = {b.memory.data(), b.used},
             .index = free,
             .sequence = static_cast<std::uint32_t>(index),
             .timestamp_ns = (t - event_to_capture(settings_.event, shutter)).ns(),
             .clock = TimestampClock::monotonic,
             .event = settings_.event,
             .error = b.used == 0,
             .t_taken = t + to_end};
  done_.push_back(free);
  return true;
}

FrameStatus EmulatedCapture::next(RawFrame& out) {
  if (done_.empty()) return FrameStatus::none;
  out = buffers_[done_.front()].frame;
  done_.pop_front();
  return FrameStatus::frame;
}

bool EmulatedCapture::release(const RawFrame& frame) {
  if (frame.index < buffers_.size()) buffers_[frame.index].queued = true;
  return true;
}

void EmulatedCapture::stop() {
  running_ = false;
  done_.clear();
  buffers_.clear();
}

}  // namespace rigor::v4l2
