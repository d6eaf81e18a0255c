// The cyclic executive: steps in the order of the data flow, on a grid of instants that never moves.
//
//   Executive loop({.period = milliseconds(1), .spin = microseconds(100), .cycles = 10'000});
//   loop.add_step({.name = "app", .after = {"inputs"}}, [&](const CycleContext& c) noexcept { ... });
//   loop.add_step({.name = "inputs"},                   [&](const CycleContext& c) noexcept { ... });
//   loop.add_step({.name = "slow", .divisor = 10, .after = {"inputs"}}, ...);   // every tenth cycle
//   loop.arm();                  // order: inputs, app, slow; or an error that names the circle
//   Result<RunSummary> s = loop.run(stop.token(), [&]() -> Result<BenchTime> {
//     const BenchTime t0 = bench_now() + milliseconds(50);      // this thread is the loop's by now
//     ... tell everybody who has to know ...
//     return t0;
//   });
//
// Cycle k belongs to the grid point t0 + k·period, however late it was woken; for a period that is no whole
// number of nanoseconds rounded once, so that the grid does not drift (period.h).
//
//   grid    |k        |k+1      |k+2      |k+3
//   skip    ███████████████      ·        █████     k overran: k+1 is skipped and counted, k+2 is on its
//   point log     ███████████████████  ████ ████          every cycle runs, late ones without a pause, until
//   caught up abort   ███████████████■                        the loop stops with StopReason::overrun; sinks
//   make safe
//
// A wake-up that comes a whole period late or more runs the cycle of the present grid interval and counts the
// ones before it as skipped (skip), runs them all (log), or stops (abort). Always: run + skipped = grid
// points passed.
//
// In virtual time nothing sleeps: cycle follows cycle as soon as `before_cycle` returns, and nothing
// overruns.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "rt-core/heartbeat.h"
#include "rt-core/histogram.h"
#include "rt-core/miss_report.h"
#include "rt-core/period.h"
#include "rt-core/realtime_setup.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "rt-core/time.h"

namespace rigor {

class Trace;

enum class RunClock : std::uint8_t { wall, virtual_time };
enum class OverrunPolicy : std::uint8_t { skip, abort, log };

/// What a step knows of its cycle.
struct CycleContext {
  std::uint64_t index = 0;  ///< k: of the grid, so skipped cycles leave a gap
  BenchTime t;              ///< t0 + k·period
  BenchTime t_next;         ///< the grid point after it: the deadline
  bool virtual_time = false;
};

/// A piece of the loop. Called on the loop's thread; real-time: no allocation, lock, log, exception, blocking
/// call.
class Step {
 public:
  virtual ~Step() = default;
  virtual void run(const CycleContext& cycle) noexcept = 0;
};

struct StepConfig {
  std::string name;
  std::uint32_t divisor = 1;         ///< runs in the cycles k with k mod divisor == phase
  std::uint32_t phase = 0;           ///< < divisor
  std::vector<std::string> after{};  ///< steps whose results it uses: they run before it in the same cycle
};

/// Called around the steps.
class ExecutiveHooks {
 public:
  virtual ~ExecutiveHooks() = default;
  /// Virtual time only, before each cycle; may block and allocate: let the sources complete until `t`. What
  /// it throws ends the run and leaves run(); the executive is armed again.
  virtual void before_cycle(BenchTime t) { (void)t; }
  /// Real-time, before the first and after the last step of each cycle.
  virtual void cycle_begin(const CycleContext& cycle) noexcept { (void)cycle; }
  virtual void cycle_end(const CycleContext& cycle) noexcept { (void)cycle; }
  /// Real-time, at the end of each cycle. False: the heartbeat is not beaten, for nobody commands the sinks.
  [[nodiscard]] virtual bool in_charge() const noexcept { return true; }
};

struct ExecutiveConfig {
  Period period = milliseconds(1);
  RunClock clock = RunClock::wall;
  Duration spin{};  ///< busy-wait the last part of each sleep; 0: only sleep
  OverrunPolicy on_overrun = OverrunPolicy::skip;
  std::uint64_t cycles = 0;          ///< grid points of the run; 0: until stopped
  Duration report_late{};            ///< wake-ups later than this are misses; 0: half a period
  std::size_t miss_capacity = 1024;  ///< misses kept with their numbers; more are counted
  RealtimeConfig realtime = RealtimeConfig::none();
  Heartbeat* heartbeat = nullptr;  ///< beaten each cycle, told when the loop stops
  Trace* trace = nullptr;          ///< wake-ups and steps are traced into it
  ExecutiveHooks* hooks = nullptr;
};

/// Grid points within `duration`: those with t < t0 + duration. Setup.
[[nodiscard]] constexpr std::uint64_t cycles_in(Duration duration, const Period& period) {
  return static_cast<std::uint64_t>(period.first_index_from(duration));
}

/// Counters for a status line; written by the loop, read by any thread at any time.
struct LoopCounters {
  std::atomic<std::uint64_t> cycle{0};  ///< next grid index
  std::atomic<std::uint64_t> run{0}, skipped{0}, overruns{0}, misses{0};
  std::atomic<std::int64_t> last_wake_error_ns{0}, last_cycle_ns{0};
};

struct StepTiming {
  std::string name;
  std::uint64_t runs = 0;
  Histogram ran;
};

/// What a run was like.
struct RunSummary {
  StopReason reason = StopReason::none;
  BenchTime t0;
  Period period;
  std::uint64_t cycles_run = 0;
  std::uint64_t cycles_skipped = 0;  ///< cycles_run + cycles_skipped == grid points passed
  std::uint64_t overruns =
      0;  ///< times that a deadline (the next grid point) was missed, by the steps or by the wake-up
  std::uint64_t late_wakeups = 0;  ///< wake-ups later than report_late
  Histogram wake_error;            ///< t_woke − t_k; not of cycles that `log` runs late without a pause
  Histogram cycle_time;            ///< begin of the first step to end of the last
  Histogram bookkeeping;           ///< wall runs: end of the last step to the next sleep, the executive's own
  std::vector<StepTiming> steps;   ///< in the order of execution
  MissReport misses;
  std::vector<RealtimeSetting> settings;             ///< what the machine granted
  std::uint64_t minor_faults = 0, major_faults = 0;  ///< of the loop's thread between first and last cycle
};

class Executive {
 public:
  enum class State : std::uint8_t { configuring, armed, running };

  explicit Executive(ExecutiveConfig config);
  ~Executive();
  Executive(const Executive&) = delete;
  Executive& operator=(const Executive&) = delete;

  /// Setup, state configuring. The step outlives the executive. bad_input: empty or taken name, divisor 0,
  /// phase not below divisor.
  Status add_step(StepConfig config, Step& step);
  /// The same with a callable `void(const CycleContext&) noexcept`, which the executive keeps.
  template <class F>
  requires(!std::is_base_of_v<Step, std::remove_cvref_t<F>>) Status add_step(StepConfig config, F&& f) {
    using Fn = std::remove_cvref_t<F>;
    static_assert(std::is_nothrow_invocable_r_v<void, Fn&, const CycleContext&>,
                  "a step is `[...](const CycleContext&) noexcept { ... }`");
    struct Holder final : Step {
      explicit Holder(F&& g) : fn(std::forward<F>(g)) {}
      void run(const CycleContext& c) noexcept override { fn(c); }
      Fn fn;
    };
    auto holder = std::make_unique<Holder>(std::forward<F>(f));
    Status added = add_step(std::move(config), static_cast<Step&>(*holder));
    if (added) owned_.push_back(std::move(holder));
    return added;
  }

  /// Setup, configuring → armed. Sorts the steps (ties by the order of add_step), takes all memory, locks it,
  /// asks for the process-wide real-time settings. bad_input: unknown name in `after`, a circle (named), a
  /// bad period.
  Status arm();
  /// Chooses t0 and publishes it to whoever has to know it. Called once per run, on the loop's thread.
  using Begin = std::function<Result<BenchTime>()>;
  /// armed → running → armed. Blocks the calling thread, which becomes the loop until the cycles are done or
  /// the token says stop. `begin` is called when the thread has its priority, CPU and memory, so that nothing
  /// slow comes between it and the first cycle. Where t0 has passed nevertheless when the loop gets to it (a
  /// busy machine), that is a late wake-up like any other: see on_overrun. An error of `begin` is returned;
  /// no cycle was run, and the executive is armed again.
  Result<RunSummary> run(StopToken stop, const Begin& begin);
  /// The same from a given t0. Wall: it lies in the future, by more than setting up the thread takes;
  /// virtual: any instant, usually 0. bad_input when it has passed by the time the thread is set up.
  Result<RunSummary> run(StopToken stop, BenchTime t0);
  /// Virtual time, in place of `run`, for whoever looks at the state between cycles: begin (armed → running),
  /// advance until it says that the run is over, end (running → armed). One thread. wrong_state: another run
  /// is in progress; in wall-clock time.
  Status begin(const Begin& begin_run);
  /// Runs up to `cycles` cycles. False: the run is over, by its last cycle, `stop` or `fail_run`. What
  /// `before_cycle` throws leaves this function, and the run is over (armed).
  bool advance(std::uint64_t cycles, StopToken stop);
  RunSummary end();
  /// Setup, armed → configuring; memory is unlocked, steps stay.
  Status disarm();

  /// A step or hook found that the run cannot go on: the loop stops at the end of this cycle with this
  /// reason. Any thread, wait-free.
  void fail_run(StopReason reason = StopReason::failed) noexcept {
    failed_.store(reason, std::memory_order_release);
  }

  [[nodiscard]] State state() const noexcept { return state_.load(std::memory_order_acquire); }
  [[nodiscard]] const ExecutiveConfig& config() const noexcept { return config_; }
  /// Names in the order of execution; once armed.
  [[nodiscard]] std::vector<std::string> order() const;
  [[nodiscard]] const LoopCounters& counters() const noexcept { return counters_; }
  /// Real-time settings asked for so far; complete after run.
  [[nodiscard]] const std::vector<RealtimeSetting>& settings() const { return realtime_.settings(); }

 private:
  struct Entry {
    StepConfig config;
    Step* step;
  };
  struct Slot {  // what the loop walks
    Step* step;
    std::uint32_t divisor, phase, trace_name;
  };
  struct LoopData;  // histograms and tables of one run

  [[nodiscard]] Status sort_steps();
  void loop_wall(StopToken stop, LoopData& data) noexcept;
  [[nodiscard]] Status prepare_run();
  RunSummary close_run();
  void give_up() noexcept;
  void run_steps(const CycleContext& cycle, LoopData& data) noexcept;
  [[nodiscard]] bool in_charge() const noexcept {
    return config_.heartbeat && (!config_.hooks || config_.hooks->in_charge());
  }

  ExecutiveConfig config_;
  std::atomic<State> state_{State::configuring};
  std::vector<Entry> entries_;
  std::vector<std::unique_ptr<Step>> owned_;
  std::vector<std::size_t> order_;
  std::vector<Slot> slots_;
  std::unique_ptr<LoopData> data_;
  RealtimeSetup realtime_;
  LoopCounters counters_;
  std::atomic<StopReason> failed_{StopReason::none};
};

}  // namespace rigor
