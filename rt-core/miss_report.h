// Why was a cycle late? The loop notes facts; a thread of low priority finds the cause afterwards.
//
// A cycle misses when it was still running at the next grid point, or when its wake-up came later than a
// limit. At that moment the loop writes one Miss with what it knows of itself for nothing: times, page faults
// and context switches since the cycle before, CPU time. What only /proc knows (time on the run queue, CPU
// time that the host took away) is sampled every few milliseconds by the observer, so that a miss lies
// between two samples. The loop makes no file access.
//
//   cause         what was seen
//   page_fault    faults during the cycle, and the steps were long
//   execution     the steps were long, and the thread had the CPU all the time; the longest step is named
//   preemption    steps or wake-up long because something else had the CPU: time on the run queue
//   host_steal    the CPU itself was away: steal time of a virtual machine
//   late_wakeup   the timer or the kernel came late, and none of the above explains it
//   unknown       the numbers do not decide; they are in the Miss
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "rt-core/fixed_ring.h"
#include "rt-core/spsc_ring.h"
#include "rt-core/time.h"

namespace rigor {

enum class MissCause : std::uint8_t { execution, late_wakeup, page_fault, preemption, host_steal, unknown };
inline constexpr std::size_t kMissCauses = 6;

[[nodiscard]] constexpr const char* to_string(MissCause c) noexcept {
  constexpr std::array<const char*, kMissCauses> kNames{"execution",  "late wake-up", "page fault",
                                                        "preemption", "host steal",   "unknown"};
  return kNames[static_cast<std::size_t>(c)];
}

/// What the loop saw of a cycle that missed.
struct Miss {
  std::uint64_t cycle = 0;
  BenchTime t_cycle;        ///< its grid point
  BenchTime t_woke, t_end;  ///< when it really began and ended
  Duration late;            ///< t_woke − t_cycle
  Duration ran;             ///< t_end − t_woke
  Duration cpu;             ///< CPU time of the thread within `ran`
  bool overran = false;     ///< t_end was after the next grid point; else only the wake-up was late
  std::uint32_t minor_faults = 0, major_faults = 0;     ///< since the end of the cycle before
  std::uint32_t voluntary_switches = 0, preempted = 0;  ///< context switches, since the same
  std::uint32_t longest_step = 0;                       ///< index in Executive::order()
  Duration longest_step_ran;
  std::uint64_t skipped = 0;  ///< cycles skipped because of it
  // Filled by the observer:
  Duration run_queue;  ///< the thread was ready but did not run, around the miss
  Duration stolen;     ///< taken by the host from this thread's CPU, around the miss (steps of 10 ms)
  MissCause cause = MissCause::unknown;
};

/// The rule of the table above, on a miss whose numbers are complete. Any thread, no allocation.
[[nodiscard]] MissCause attribute(const Miss& miss, Duration period) noexcept;
/// One line for people: cycle, by how much, cause, and the numbers that say so. Allocates.
[[nodiscard]] std::string describe(const Miss& miss, Duration period, const std::string& step_name);

/// Ticks that the host took from a CPU, as /proc/stat says; none: it does not name this CPU. No allocation.
[[nodiscard]] std::optional<long long> stolen_ticks(const char* proc_stat, int cpu) noexcept;
/// Room for the lines of the CPUs in /proc/stat, which come first: ten numbers of up to 20 digits each.
[[nodiscard]] constexpr std::size_t room_for_proc_stat(int cpus) {
  return (static_cast<std::size_t>(cpus > 0 ? cpus : 1) + 1) * 232 + 1;
}

struct MissReport {
  std::vector<Miss> misses;                           ///< the first `capacity`, in order
  std::array<std::uint64_t, kMissCauses> by_cause{};  ///< of all that were attributed
  std::uint64_t total = 0;                            ///< misses that happened
  std::uint64_t dropped = 0;                          ///< of these, not in `misses`: no room
};

/// The thread that looks at /proc while the loop runs.
class MissObserver {
 public:
  /// Setup thread. Keeps the first `capacity` misses.
  MissObserver(Duration period, std::size_t capacity);
  ~MissObserver();
  MissObserver(const MissObserver&) = delete;
  MissObserver& operator=(const MissObserver&) = delete;

  /// Setup: begin to watch the thread `tid` (gettid) while it runs.
  void start(int tid);
  /// Loop thread: wait-free; counted when there is no room.
  void report(const Miss& miss) noexcept;
  /// Setup: attribute what is left, end the thread, hand out the report.
  [[nodiscard]] MissReport finish();

 private:
  struct Sample {
    std::int64_t t_ns = 0, run_queue_ns = 0, stolen_ns = 0;
  };
  void watch();
  Sample sample() noexcept;
  void attribute_waiting(bool final_pass);

  Duration period_;
  std::size_t capacity_;
  SpscRing<Miss> ring_;
  std::atomic<std::uint64_t> total_{0}, ring_full_{0};
  MissReport report_;
  std::vector<Miss> waiting_;
  FixedRing<Sample, 256> samples_;
  std::vector<char> text_;
  int schedstat_fd_ = -1, schedule_fd_ = -1, stat_fd_ = -1;
  std::atomic<bool> end_{false};
  std::thread thread_;
};

}  // namespace rigor
