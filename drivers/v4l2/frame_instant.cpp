#include "drivers/v4l2/frame_instant.h"

#include <algorithm>
#include <cmath>

namespace rigor::v4l2 {
namespace {

constexpr Duration kNear = seconds(10);
// A frame cannot have been stamped after it was here: such a stamp says when the driver thinks that it will
// be.
constexpr Duration kAhead = milliseconds(1);
// A timeval has whole microseconds: uniform within one, 1 µs / √12.
constexpr double kTimevalSigmaNs = 289;
// A step over half the circle of 32 bits is a count that began anew.
constexpr std::uint32_t kHalf = 1u << 31;

Duration absolute(Duration d) { return d.ns() < 0 ? -d : d; }

}  // namespace

Duration event_to_capture(TimestampEvent event, const Shutter& s) noexcept {
  if (event == TimestampEvent::start_of_exposure)
    return s.global ? s.exposure / 2 : (s.exposure + s.readout) / 2;
  return s.global ? -(s.exposure / 2 + s.readout) : -((s.exposure + s.readout) / 2);
}

FrameInstant frame_instant(const RawFrame& frame, const Shutter& shutter, Duration realtime_ahead) noexcept {
  FrameInstant f;
  f.t = BenchTime(frame.timestamp_ns);
  double variance = kTimevalSigmaNs * kTimevalSigmaNs;
  if (frame.clock == TimestampClock::monotonic) {
    f.sure = f.t <= frame.t_taken + kAhead;
    if (!f.sure) f.t = frame.t_taken;
  } else if (absolute(f.t - frame.t_taken) > kNear) {
    const BenchTime from_utc = f.t - realtime_ahead;
    f.sure = absolute(from_utc - frame.t_taken) <= kNear;
    f.t = f.sure ? from_utc : frame.t_taken;
  }
  const TimestampEvent event = f.sure ? frame.event : TimestampEvent::end_of_frame;
  f.t = f.t + event_to_capture(event, shutter);
  if (!shutter
           .exposure_known) {  // somewhere in 0 … period: the middle of the exposure is off by half of that
    const double width = static_cast<double>(shutter.period.ns()) / 2;
    variance += width * width / 12;
  }
  if (!f.sure) {
    const double width = static_cast<double>(std::max(shutter.period, milliseconds(1)).ns());
    variance += width * width / 12;
  }
  f.sigma = Duration(static_cast<std::int64_t>(std::sqrt(variance)));
  return f;
}

CaptureCount::Step CaptureCount::step(std::uint32_t device_sequence, BenchTime t) noexcept {
  Step s;
  if (started_) {
    const std::uint32_t forward = device_sequence - last_device_;
    if (device_counts_ && forward >= kHalf && t < t_last_) return {.sequence = sequence_, .late = true};
    std::uint64_t by = forward;
    if (!device_counts_ || forward == 0 || forward >= kHalf) {
      const std::int64_t periods = period_.ns() > 0 ? (t - t_last_ + period_ / 2) / period_ : std::int64_t{1};
      by = static_cast<std::uint64_t>(std::max<std::int64_t>(1, periods));
    }
    sequence_ += by;
    s.lost = by - 1;
  }
  started_ = device_counts_ = true;
  last_device_ = device_sequence;
  t_last_ = t;
  s.sequence = sequence_;
  return s;
}

std::uint64_t CaptureCount::give_up_until(BenchTime t) noexcept {
  if (!started_ || period_.ns() <= 0 || t <= t_last_) return 0;
  const std::int64_t whole = (t - t_last_) / period_;
  if (whole <= 0) return 0;
  sequence_ += static_cast<std::uint64_t>(whole);
  t_last_ = t_last_ + period_ * whole;
  device_counts_ = false;
  return static_cast<std::uint64_t>(whole);
}

}  // namespace rigor::v4l2
