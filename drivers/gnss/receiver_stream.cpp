#include "drivers/gnss/receiver_stream.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rigor::gnss {

ReceiverStream::ReceiverStream(const Options& options, Handler handler)
    : options_(options),
      handler_(std::move(handler)),
      clock_({options.time, microseconds(1), options.output_delay, options.output_delay_sigma}),
      epochs_(options.epoch, {.solution = [this](const Solution& s, BenchTime t) { place_solution(s, t); },
                              .sky = [this](const Sky& s) { place_sky(s); },
                              .pulse =
                                  [this](const TimePulse& p) {
                                    announced_ = p;
                                    announced_at_ = now_;
                                    if (handler_.pulse) handler_.pulse(p);
                                  },
                              .raw =
                                  [this](Bytes payload) {
                                    if (handler_.raw) handler_.raw(payload);
                                  }}) {}

void ReceiverStream::drain(BenchTime arrival) {
  now_ = arrival;
  while (const auto m = messages_.next()) {
    if (handler_.message) handler_.message(*m);
    epochs_.take(*m, begun_);
    begun_ = arrival;  // what is behind it came with this piece
  }
}

void ReceiverStream::take(Bytes bytes, BenchTime arrival) {
  if (messages_.pending() == 0) begun_ = arrival;
  messages_.add(bytes);
  drain(arrival);
}

void ReceiverStream::idle() { epochs_.flush(); }

void ReceiverStream::finish() {
  if (messages_.finish()) drain(now_);
  epochs_.flush();
}

void ReceiverStream::reconnected() {
  messages_.reset();
  epochs_.reset();
  clock_.reset();
  announced_.reset();
  before_.reset();
  any_ = false;
}

void ReceiverStream::take_edge(BenchTime before, BenchTime after) {
  constexpr Duration kAhead = milliseconds(1500);
  if (!announced_ || after - announced_at_ > kAhead) return;
  ++counters_.edges;
  // The edge comes when the receiver's clock ticks: `quantization` later than the time that was announced.
  const double late_ns = std::isfinite(announced_->quantization_ns) ? announced_->quantization_ns : 0;
  clock_.latch(announced_->t_device + nanoseconds(std::llround(late_ns)), before, after);
  announced_.reset();
}

/// Whether this arrival says something of the receiver's clock: neither it nor the one before was held up.
bool ReceiverStream::in_step(DeviceTime t, BenchTime arrival) {
  const auto before = std::exchange(before_, std::pair(t, arrival));
  if (!before) return false;
  const Duration by_receiver = t - before->first, by_bench = arrival - before->second;
  const Duration off = by_bench - by_receiver;
  // What messages usually scatter by; at high rates less than what would hide a held one.
  const Duration most = std::min(options_.output_delay_sigma * 3, by_receiver / 2);
  return off <= most && -off <= most;
}

void ReceiverStream::place_solution(Solution s, BenchTime arrival) {
  if (options_.repair_rollover && s.utc)
    if (const auto utc = repaired_rollover(*s.utc, realtime_now())) {
      s.utc = *utc;
      ++counters_.rollovers;
    }
  const bool by_date = options_.time == TimeSource::utc;
  const DeviceTime t = by_date ? DeviceTime(s.utc ? s.utc->ns() : 0) : s.t_device;
  const bool placed = !by_date || s.utc.has_value();
  const bool learns = options_.time != TimeSource::device || in_step(t, arrival);
  if (placed && learns && !clock_.observe(t, options_.output_delay, arrival)) ++counters_.clock_steps;
  Place p;
  p.arrival = arrival;
  if (std::exchange(any_, true)) {
    const std::int64_t step = (s.t_device - last_time_).ns(), period = options_.period.ns();
    // Set anew, or away for long: what was lost is not known.
    if (period > 0 && step > 0 && step < 3'600'000'000'000)
      p.lost_before = static_cast<std::uint64_t>(std::max<std::int64_t>(0, (step + period / 2) / period - 1));
    sequence_ += 1 + p.lost_before;
    counters_.solutions_lost += p.lost_before;
  } else if (sequence_ > 0) {
    ++sequence_;
  }
  last_time_ = s.t_device;
  p.sequence = sequence_;
  const auto at = clock_.place(t);
  const bool known = placed && at.known;
  p.t_capture = known ? at.t : arrival - options_.output_delay;
  p.sigma = known ? at.sigma : options_.output_delay_sigma;
  if (!known) p.validity |= kClockUnsure;
  last_ = s;
  last_place_ = p;
  if (handler_.solution) handler_.solution(s, p);
}

void ReceiverStream::place_sky(const Sky& sky) {
  Place p = last_place_;
  bool placed = any_;
  if (sky.t_device && options_.time != TimeSource::utc) {
    const auto at = clock_.place(*sky.t_device);
    if (at.known) p.t_capture = at.t, p.sigma = at.sigma, p.validity = 0, placed = true;
  } else if (sky.t_device && any_) {
    p.t_capture = last_place_.t_capture + (*sky.t_device - last_time_);
  }
  if (!placed) return;  // before the first solution nothing says when it was
  p.sequence = sky_sequence_++;
  p.lost_before = 0;
  if (handler_.sky) handler_.sky(sky, p);
}

}  // namespace rigor::gnss
