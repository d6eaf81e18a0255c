// The loop's pulse. The loop beats once a cycle; the I/O thread of each sink looks at the pulse by itself,
// and makes its device safe when the pulse is late or the loop has said that it stopped. So a loop that
// hangs, crashes out of run() or is aborted cannot keep an actuator moving, and nothing in the loop has to
// work for that.
//
//   // sink's I/O thread, a few times per deadline
//   if (must_be_safe(heartbeat->check(monotonic_now(), deadline))) apply_safe_values();
#pragma once

#include <atomic>
#include <cstdint>

#include "rt-core/stop.h"
#include "rt-core/time.h"

namespace rigor {

enum class LoopPulse : std::uint8_t {
  not_started,  ///< no beat yet: devices keep the state that arm gave them
  alive,        ///< the last beat is younger than the deadline
  silent,       ///< no beat for longer than the deadline: the loop hangs
  stopped       ///< the loop said that it ended, whatever the reason
};

[[nodiscard]] constexpr bool must_be_safe(LoopPulse p) noexcept {
  return p == LoopPulse::silent || p == LoopPulse::stopped;
}

/// One writer (the loop; any thread may declare_stopped), any number of readers; wait-free, no allocation.
class Heartbeat {
 public:
  /// Loop thread, each cycle. `now` is bench time of the beat.
  void beat(BenchTime now) noexcept {
    beats_.fetch_add(1, std::memory_order_relaxed);
    last_.store(virtual_time_ ? 0 : now.ns(), std::memory_order_release);
  }
  /// Any thread, also signal handlers: the loop is over. Final until restart(); the first reason stays.
  void declare_stopped(StopReason reason) noexcept {
    std::uint8_t none = 0;
    stopped_.compare_exchange_strong(none, static_cast<std::uint8_t>(reason), std::memory_order_acq_rel);
  }
  /// Setup thread, while no loop runs. In virtual time wall time says nothing about the loop: it is never
  /// `silent`.
  void restart(bool virtual_time) noexcept {
    virtual_time_ = virtual_time;
    beats_.store(0, std::memory_order_relaxed);
    last_.store(kNever, std::memory_order_relaxed);
    stopped_.store(0, std::memory_order_release);
  }

  /// Any thread: how the loop is, judged at `now`.
  [[nodiscard]] LoopPulse check(MonotonicTime now, Duration deadline) const noexcept {
    if (stopped_.load(std::memory_order_acquire) != 0) return LoopPulse::stopped;
    const std::int64_t last = last_.load(std::memory_order_acquire);
    if (last == kNever) return LoopPulse::not_started;
    if (last != 0 && now.ns() - last > deadline.ns()) return LoopPulse::silent;
    return LoopPulse::alive;
  }
  /// True when a device that this loop commands has to be safe.
  [[nodiscard]] bool expired(MonotonicTime now, Duration deadline) const noexcept {
    return must_be_safe(check(now, deadline));
  }
  [[nodiscard]] StopReason stop_reason() const noexcept {
    return static_cast<StopReason>(stopped_.load(std::memory_order_acquire));
  }
  [[nodiscard]] std::uint64_t beats() const noexcept { return beats_.load(std::memory_order_relaxed); }

 private:
  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::min();
  bool virtual_time_ = false;
  std::atomic<std::int64_t> last_{kNever};  // monotonic ns of the last beat; 0 in virtual time
  std::atomic<std::uint64_t> beats_{0};
  std::atomic<std::uint8_t> stopped_{0};
};

}  // namespace rigor
