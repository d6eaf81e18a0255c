// What a loop needs of the machine, asked for politely: what was granted, what was not, why, and what to do.
//
//   RealtimeSetup setup;
//   setup.prepare_process(config);              // memory, power management: once, at arm
//   { ThreadRealtime thread(setup, config); ... loop ... }   // priority, CPU, stack: in the loop's thread
//   for (const RealtimeSetting& s : setup.settings()) print(s.name, s.granted, s.text);
//
// Nothing here fails a run: a bench on a laptop without rights still runs, and its report says what it
// lacked.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rt-core/time.h"

namespace rigor {

struct RealtimeConfig {
  static constexpr int kAnyCpu = -1;  ///< do not pin
  static constexpr int kAutoCpu =
      -2;                   ///< pin to the last CPU that this process may use, if it has more than one
  int fifo_priority = 80;   ///< SCHED_FIFO 1..99; 0: leave the scheduler alone
  int cpu = kAutoCpu;       ///< number of a CPU, kAnyCpu or kAutoCpu
  bool lock_memory = true;  ///< mlockall
  std::size_t prefault_stack_bytes = 256 * 1024;
  bool hold_dma_latency = true;  ///< /dev/cpu_dma_latency at 0: no deep CPU sleep while the loop runs

  /// Asks for nothing: virtual time, tests.
  static RealtimeConfig none() { return {0, kAnyCpu, false, 0, false}; }
};

struct RealtimeSetting {
  std::string name;     ///< "SCHED_FIFO", "CPU affinity", "memory lock", "stack prefault", "CPU latency"
  bool wanted = false;  ///< the configuration asked for it
  bool granted = false;
  std::string text;  ///< a plain sentence: what is in force, or why not and what to do
};

class RealtimeSetup {
 public:
  RealtimeSetup() = default;
  ~RealtimeSetup();
  RealtimeSetup(const RealtimeSetup&) = delete;
  RealtimeSetup& operator=(const RealtimeSetup&) = delete;

  /// Setup thread: lock the memory of the process, hold the CPU's latency down.
  void prepare_process(const RealtimeConfig& config);
  /// The loop's thread, for itself: stack, CPU, priority (in that order). Old values are kept for
  /// restore_thread.
  void prepare_thread(const RealtimeConfig& config);
  /// The same thread: give back priority and affinity.
  void restore_thread() noexcept;
  /// Setup thread: unlock memory, let the CPU sleep again.
  void restore_process() noexcept;

  [[nodiscard]] const std::vector<RealtimeSetting>& settings() const { return settings_; }

 private:
  void set(RealtimeSetting setting);
  std::vector<RealtimeSetting> settings_;
  int dma_latency_fd_ = -1;
  bool locked_ = false;
  bool thread_changed_ = false;
  int old_policy_ = 0, old_priority_ = 0;
  std::vector<unsigned char> old_affinity_;
};

/// `rigor doctor`: try each setting in a thread of its own, give it back at once, and say how it went; beside
/// them what else matters to a loop on this machine (kernel preemption model, clock source, virtual machine,
/// isolated CPUs, RT throttling).
[[nodiscard]] std::vector<RealtimeSetting> probe_realtime(const RealtimeConfig& config = {});

}  // namespace rigor
