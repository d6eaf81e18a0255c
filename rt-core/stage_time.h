// How long a stage of a run took, all in all: always on, two clock reads a pass.
//
//   { StageTime::Scope scope(times.light); … }
#pragma once

#include <time.h>

#include <atomic>
#include <chrono>
#include <cstdint>

#include "rt-core/time.h"

namespace rigor {

/// Milliseconds from `begin` until now. Any thread.
[[nodiscard]] inline double ms_since(std::chrono::steady_clock::time_point begin) noexcept {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

/// Written by one thread at a time, read by any.
struct StageTime {
  std::atomic<std::uint64_t> count{0};
  std::atomic<std::int64_t> wall_ns{0};  ///< sum
  std::atomic<std::int64_t> cpu_ns{0};   ///< of the thread that called; helpers of a renderer are not in it
  std::atomic<std::int64_t> longest_ns{0};

  /// Any thread, wait-free.
  void add(Duration wall, Duration cpu) noexcept {
    count.fetch_add(1, std::memory_order_relaxed);
    wall_ns.fetch_add(wall.ns(), std::memory_order_relaxed);
    cpu_ns.fetch_add(cpu.ns(), std::memory_order_relaxed);
    if (wall.ns() > longest_ns.load(std::memory_order_relaxed))
      longest_ns.store(wall.ns(), std::memory_order_relaxed);
  }

  [[nodiscard]] static Duration thread_cpu() noexcept {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return Duration(std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec);
  }

  /// Adds the time that it lived. `stage` may be null.
  class Scope {
   public:
    explicit Scope(StageTime* stage) noexcept : stage_(stage) {
      if (stage_) wall_ = monotonic_now(), cpu_ = thread_cpu();
    }
    ~Scope() {
      if (stage_) stage_->add(monotonic_now() - wall_, thread_cpu() - cpu_);
    }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;

   private:
    StageTime* stage_;
    MonotonicTime wall_;
    Duration cpu_;
  };
};

}  // namespace rigor
