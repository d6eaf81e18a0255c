// The instant t0 at which a run begins, for threads that already run before it is known.
//
//   setup thread   arm: starts the I/O thread
//   I/O thread     auto t0 = origin.wait(deadline);      what measures on the grid of t0
//                  if (!origin.covers(t_capture, period)) discard;      what reads a free-running device
//   loop thread    start(t0): publish
//
// Publishing is one store: no lock, no system call, nobody is woken. A thread that waits looks every kLook,
// so no wake-up can be lost; the loop leaves several kLook between publishing t0 and t0.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <limits>
#include <optional>

#include "rt-core/deadline.h"
#include "rt-core/time.h"

namespace rigor {

class RunOrigin {
 public:
  static constexpr Duration kLook = milliseconds(2);

  /// Setup thread, while no thread reads it: the next run is not known yet.
  void forget() noexcept { t0_ns_.store(kUnknown, std::memory_order_relaxed); }
  /// Loop or setup thread, wait-free. What the caller wrote before is visible to whoever sees the origin.
  void publish(BenchTime t0) noexcept { t0_ns_.store(t0.ns(), std::memory_order_release); }

  /// Any thread, wait-free; empty while it is not known.
  [[nodiscard]] std::optional<BenchTime> get() const noexcept {
    const std::int64_t ns = t0_ns_.load(std::memory_order_acquire);
    return ns == kUnknown ? std::nullopt : std::optional(BenchTime(ns));
  }
  /// I/O thread: blocks until it is known; empty when `deadline` was cut.
  [[nodiscard]] std::optional<BenchTime> wait(Deadline& deadline) const noexcept {
    auto t0 = get();
    for (; !t0; t0 = get())
      if (!deadline.wait_until(monotonic_now() + kLook)) return std::nullopt;
    return t0;
  }
  /// Any thread, wait-free: whether a capture belongs to the run. A periodic device need not be in phase with
  /// t0, so its first capture may lie up to half a period before. `period` 0: aperiodic. False while the
  /// origin is not known.
  [[nodiscard]] bool covers(BenchTime t_capture, Duration period) const noexcept {
    const auto t0 = get();
    return t0 && t_capture + period / 2 >= *t0;
  }

 private:
  static constexpr std::int64_t kUnknown = std::numeric_limits<std::int64_t>::min();
  std::atomic<std::int64_t> t0_ns_{kUnknown};
};

/// The sequence of a channel whose device has counted its captures since before the run: the first capture of
/// the run is 0, and of the captures lost before it only those count that belong to the run. One thread.
class RunSequence {
 public:
  struct Place {
    std::uint64_t sequence = 0;
    std::uint64_t lost = 0;  ///< captures of the run between this one and the one before
  };
  /// Setup: before each run.
  void reset() noexcept { first_.reset(); }
  /// `sequence` and `lost`: of a capture, since the device was opened. Empty: it does not belong to the run.
  [[nodiscard]] std::optional<Place> place(const RunOrigin& origin, BenchTime t_capture, Duration period,
                                           std::uint64_t sequence, std::uint64_t lost) noexcept {
    if (!origin.covers(t_capture, period)) return std::nullopt;
    if (!first_) {
      const auto in_run =
          period.ns() > 0 ? static_cast<std::uint64_t>((t_capture + period / 2 - *origin.get()) / period) : 0;
      lost = std::min({lost, in_run, sequence});
      first_ = sequence - lost;
    }
    return Place{sequence - *first_, lost};
  }

 private:
  std::optional<std::uint64_t> first_;
};

}  // namespace rigor
