// Keeps threads that work in the kernel for long (writing, syncing) off the loop's CPU.
//
// A kernel without full preemption finishes what it does for a thread before it lets even a SCHED_FIFO thread
// of the same CPU run: an fdatasync of a recording held the loop up for 5 ms, once a second.
#pragma once

#include <sched.h>

#include "rt-core/realtime_setup.h"

namespace rigor {

/// The CPU that a loop with this configuration will be pinned to, or -1. Setup context.
[[nodiscard]] inline int loop_cpu(const RealtimeConfig& config) {
  if (config.cpu != RealtimeConfig::kAutoCpu) return config.cpu == RealtimeConfig::kAnyCpu ? -1 : config.cpu;
  cpu_set_t mine{};
  if (sched_getaffinity(0, sizeof mine, &mine) != 0 || CPU_COUNT(&mine) < 2) return -1;
  int last = -1;
  for (int cpu = 0; cpu < CPU_SETSIZE; ++cpu)
    if (CPU_ISSET(static_cast<unsigned>(cpu), &mine)) last = cpu;
  return last;
}

/// While it lives, threads made by this thread may run on any CPU that this thread may use, but for `cpu`.
/// Without effect where there is no other. Setup context.
class AvoidCpu {
 public:
  explicit AvoidCpu(int cpu) {
    if (cpu < 0 || sched_getaffinity(0, sizeof old_, &old_) != 0 || CPU_COUNT(&old_) < 2) return;
    cpu_set_t rest = old_;
    CPU_CLR(static_cast<unsigned>(cpu), &rest);
    changed_ = sched_setaffinity(0, sizeof rest, &rest) == 0;
  }
  ~AvoidCpu() {
    if (changed_) (void)sched_setaffinity(0, sizeof old_, &old_);
  }
  AvoidCpu(const AvoidCpu&) = delete;
  AvoidCpu& operator=(const AvoidCpu&) = delete;

 private:
  cpu_set_t old_{};
  bool changed_ = false;
};

}  // namespace rigor
