#include "bench/run/tap.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "sensor-hal/channel/event_text.h"

namespace rigor::live {

// ------------------------------------------------------------------ bins

namespace {
void bump(std::atomic<std::uint64_t>& n) noexcept {  // one writer: no locked instruction
  n.store(n.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}
}  // namespace

void LiveBins::record(Duration d) noexcept {
  const std::int64_t ns = std::max<std::int64_t>(d.ns(), 0);
  std::size_t bin = 0;
  if (ns >= 1000) {
    const auto us = static_cast<std::uint64_t>(ns / 1000);
    const auto octave = static_cast<std::size_t>(std::bit_width(us)) - 1;
    const double edge = 1000.0 * static_cast<double>(std::uint64_t{1} << octave) * 1.4142135623730951;
    bin = std::min(kBins - 1, 1 + 2 * octave + (static_cast<double>(ns) >= edge));
  }
  bump(count_[bin]);
  if (ns > max_ns_.load(std::memory_order_relaxed)) max_ns_.store(ns, std::memory_order_relaxed);
}

double LiveBins::lower_us(std::size_t bin) {
  return bin == 0 ? 0 : std::exp2(static_cast<double>(bin - 1) / 2);
}

LiveBins::Read LiveBins::read() const {
  Read r;
  for (std::size_t i = 0; i < kBins; ++i) r.total += r.count[i] = count_[i].load(std::memory_order_relaxed);
  r.max_us = static_cast<double>(max_ns_.load(std::memory_order_relaxed)) * 1e-3;
  return r;
}

double LiveBins::Read::percentile_us(double share) const {
  const double rank = std::max(1.0, std::ceil(share * static_cast<double>(total)));
  std::uint64_t seen = 0;
  for (std::size_t i = 0; i < kBins; ++i) {
    seen += count[i];
    if (count[i] > 0 && static_cast<double>(seen) >= rank)
      return i + 1 == kBins ? max_us : std::min(max_us, lower_us(i + 1));
  }
  return 0;
}

// ------------------------------------------------------------------ setup

LiveTap::LiveTap(std::vector<StreamSpec> specs, bool virtual_time) {
  for (const StreamSpec& spec : specs) {
    auto stream = std::make_unique<Stream>();
    stream->used = spec.used;
    // One on its way, one being encoded, one being written.
    if (spec.used && virtual_time)
      stream->copies = make_sample_pool(4, std::max<std::size_t>(spec.max_bytes, 1));
    streams_.push_back(std::move(stream));
  }
  observers_.resize(specs.size() / 2);
  for (std::size_t i = 0; i < observers_.size(); ++i) {
    observers_[i].tap = this;
    observers_[i].channel = i;
    channels_.push_back(std::make_unique<ChannelState>());
  }
  note_pool_ = make_sample_pool(64, 0);
}

// ------------------------------------------------------------------ loop

void LiveTap::cycle(BenchTime t, Duration late, Duration ran) noexcept {
  now_ns_.store(t.ns(), std::memory_order_relaxed);
  wake_.record(late);
  cycle_time_.record(ran);
}

void LiveTap::sample(std::size_t index, const SampleLease& sample) noexcept {
  Stream& s = *streams_[index];
  if (!s.wanted.load(std::memory_order_acquire) || !sample) return;
  SampleLease lease;
  if (s.copies) {
    SampleSlot copy = s.copies->try_acquire();
    if (!copy || sample->size_bytes > copy->memory().size()) return;
    copy->stamp = sample->stamp;
    copy->info = sample->info;
    copy->size_bytes = sample->size_bytes;
    if (copy->size_bytes > 0) std::memcpy(copy->memory().data(), sample->bytes().data(), copy->size_bytes);
    lease = std::move(copy);
  } else {
    lease = sample;
  }
  s.wanted.store(false, std::memory_order_relaxed);
  (void)s.ring.try_push(std::move(lease));  // full: it holds one that nobody has looked at
}

void LiveTap::port(std::size_t index, const SamplePort& port, BenchTime now) noexcept {
  ChannelState& c = *channels_[index];
  const PortStatus status = port.status();
  if (status == PortStatus::held &&
      c.status.load(std::memory_order_relaxed) == static_cast<std::uint8_t>(status))
    return;
  c.status.store(static_cast<std::uint8_t>(status), std::memory_order_relaxed);
  const PortCounters& n = port.counters();
  c.late_samples.store(n.late_samples, std::memory_order_relaxed);
  c.disconnected_cycles.store(n.disconnected_cycles, std::memory_order_relaxed);
  c.superseded.store(n.superseded, std::memory_order_relaxed);
  c.lost.store(n.lost_samples, std::memory_order_relaxed);
  c.overflow.store(n.overflow + n.superseded, std::memory_order_relaxed);
  if (status != PortStatus::fresh || !port.sample()) return;
  c.age.record(now - port.sample()->stamp.t_capture);
  c.sequence.store(port.sample()->stamp.sequence, std::memory_order_relaxed);
  c.t_fresh_ns.store(now.ns(), std::memory_order_relaxed);
  c.t_capture_ns.store(port.sample()->stamp.t_capture.ns(), std::memory_order_relaxed);
  c.fresh.store(n.fresh, std::memory_order_relaxed);
}

void LiveTap::event(std::uint32_t channel, const SampleLease& event) noexcept {
  const auto* info = event ? event->as<EventInfo>() : nullptr;
  if (info && !events_.try_push(LiveEvent{channel, event->stamp.t_capture, *info})) bump(lost_);
}

void LiveTap::fault(const FaultChange& change) noexcept {
  FaultChange kept = change;
  kept.event.reset();
  if (!faults_.try_push(std::move(kept))) bump(lost_);
}

void LiveTap::command(std::uint32_t sink, const Command& command) noexcept {
  if (!commands_.try_push(LiveCommand{sink, command})) bump(lost_);
}

void LiveTap::motion(const WorldMotion& motion, BenchTime t) noexcept {
  want_motion_.store(false, std::memory_order_relaxed);
  motion_.store({t, ++motion_count_, motion});
}

SampleLease LiveTap::next_note(BenchTime now) noexcept {
  EventInfo* note = notes_.peek();
  if (!note) return {};
  SampleSlot slot = note_pool_->try_acquire();
  if (!slot) return {};  // the recorder has them all; it comes with one of the next cycles
  Sample& s = *slot;
  s.stamp = {};
  s.stamp.sequence = note_sequence_++;
  s.stamp.t_capture = s.stamp.t_arrival = s.stamp.t_release = now;
  s.info = *note;
  notes_.drop_front();
  return slot;
}

// ------------------------------------------------------------------ others

void LiveTap::want(std::size_t stream) noexcept {
  streams_[stream]->wanted.store(true, std::memory_order_release);
}

SampleLease LiveTap::take(std::size_t stream) noexcept {
  SampleLease newest;
  for (SampleLease lease; streams_[stream]->ring.try_pop(lease);) newest = std::move(lease);
  return newest;
}

bool LiveTap::note(std::uint32_t code, double value, std::string_view text) noexcept {
  EventInfo info;
  info.code = code;
  info.value = value;
  EventText(info).add(text);
  return notes_.try_push(std::move(info));
}

}  // namespace rigor::live
