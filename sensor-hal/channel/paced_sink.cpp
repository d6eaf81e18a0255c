#include "sensor-hal/channel/paced_sink.h"

#include <algorithm>

#include "rt-core/time_slice.h"

namespace rigor {
namespace {

constexpr std::size_t kRingPlaces = 256;

}  // namespace

Status PacedSink::open_ring(Duration loop_period, Duration tick) {
  if (auto s = deadline_.open(); !s) return s;
  ring_ = std::make_unique<SpscRing<Command>>(kRingPlaces);
  loop_period_ = loop_period;
  tick_ = tick;
  want_safe_ = false;
  return {};
}

void PacedSink::start_thread() {
  thread_ = std::thread([this] { run(); });
}

void PacedSink::stop_thread() {
  if (thread_.joinable()) {
    deadline_.cut();
    thread_.join();
  }
  if (ring_) drop_all();
}

void PacedSink::watch(const Heartbeat* heartbeat, Duration deadline) {
  heartbeat_ = heartbeat;
  heartbeat_deadline_ = deadline;
}

bool PacedSink::command(const Command& c) noexcept {
  if (!ring_ || !ring_->try_push(c)) {
    counters_.dropped.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  counters_.accepted.fetch_add(1, std::memory_order_relaxed);
  return true;
}

void PacedSink::run() {
  ask_for_time_slice(kShortTimeSlice);
  while (true) {
    auto wake = monotonic_now() + tick_;
    if (const auto* next = ring_->peek(); next && !want_safe_)
      wake = std::min(wake, MonotonicTime(next->t_effect.ns()));  // wall runs: bench time is CLOCK_MONOTONIC
    if (!deadline_.wait_until(wake)) return;
    work();
  }
}

bool PacedSink::loop_is_lost() const noexcept {
  return heartbeat_ && heartbeat_->expired(monotonic_now(), heartbeat_deadline_);
}

void PacedSink::work() {
  const bool lost = origin().get() && loop_is_lost();
  if (lost && !want_safe_) counters_.made_safe.fetch_add(1, std::memory_order_relaxed);
  want_safe_ = lost;
  tick();
  if (want_safe_) {
    drop_all();
    keep_safe();
    return;
  }
  if (apply_until(BenchTime(monotonic_now().ns()))) after();
}

bool PacedSink::apply_until(BenchTime now) {
  for (const auto* c = ring_->peek(); c && c->t_effect <= now; c = ring_->peek()) {
    // A loop that hangs is not to get its old commands through because there are many of them.
    if (has_thread() && loop_is_lost()) return false;
    apply(*c);
    ring_->drop_front();
  }
  return true;
}

void PacedSink::drop_all() {
  Command c;
  while (ring_->try_pop(c)) counters_.dropped.fetch_add(1, std::memory_order_relaxed);
}

}  // namespace rigor
