// The faults of one channel, as they come and go while a run goes on: which are on in this cycle, what they
// draw, what they touched. FaultySource and FaultySink apply them.
//
//   setup     configure(subject, seed, params)   reads `faults`; FaultBench binds triggers and adds live ones
//             arm()                              takes all memory
//   start     start(t0, loop period)
//   cycle     begin_cycle(now); for (Fault* f : active()) …; poll_change()
//
// Draws are keyed by (seed of the rig, name of the channel, index of the fault, sequence of the sample): they
// do not depend on threads, nor on what other faults do. A fault is on or off for whole cycles; it acts on
// what reaches the loop while it is on.
//
// Setup context: all but what says loop thread.
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "rt-core/fixed_ring.h"
#include "rt-core/period.h"
#include "rt-core/port.h"
#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/channel/fault_values.h"

namespace rigor {

/// Adds to a counter that other threads read.
inline void count(std::atomic<std::uint64_t>& n, std::uint64_t by = 1) noexcept {
  n.fetch_add(by, std::memory_order_relaxed);
}

/// Which fault it is. Made once, and kept by whoever tells of it.
struct FaultIdentity {
  std::string of;  ///< the channel or sink; of a pair's side `left.real`
  std::uint32_t index = 0;
  FaultKind kind{};
  bool live = false;
  std::string json, yaml;  ///< the fault with all its keys
};

/// One fault in a run.
struct Fault {
  FaultSpec spec;
  int component = 0;
  std::shared_ptr<const FrameSignal> signal;
  ConfigNode node;          ///< for messages at arm
  std::uint32_t index = 0;  ///< in its channel; live ones count on
  bool live = false;        ///< asked for while a run went on (this one, or the recorded one)
  std::shared_ptr<const FaultIdentity> identity;
  models::PhiloxKey key;
  const Port<Sample>* trigger_port = nullptr;
  int trigger_component = 0;

  // Written by the loop, read by any thread.
  struct Counters {
    std::atomic<std::uint64_t> begins{0};
    std::atomic<std::uint64_t> seen{0};     ///< samples that came while it was on
    std::atomic<std::uint64_t> dropped{0};  ///< of these: lost
    std::atomic<std::uint64_t> changed{0};  ///< values, bytes or stamps
    std::atomic<std::uint64_t> delayed{0};  ///< handed on after their release
  } count;
  std::atomic<bool> on{false};
  std::atomic<bool> over{false};  ///< a live one that will not come back
  std::atomic<bool> left{false};  ///< it is over, and the loop has let go of it

  // The loop's own.
  Duration from, until, on_for;  ///< as the spec has them; of a live one as they came about
  struct Span {
    BenchTime from, until;
  };
  static constexpr std::size_t kSpans = 128;  ///< of a scheduled one; a live one is on once
  std::vector<Span>
      spans;  ///< the first times that it was on; `until` 0 while it is; its memory is taken when it is made
  std::size_t span_count = 0;
  BenchTime t_on;
  BenchTime t_triggered;
  bool triggered = false, was_true = false;
  bool in_burst = false, burst_known = false;
  SampleLease kept;  ///< stuck
  std::array<double, 16> kept_values{};
  bool has_kept_values = false;
  std::vector<SlotHold<Sample>> held;  ///< slow_consumer; its memory is taken when it is made
};

/// A fault begins or ends.
struct FaultChange {
  std::shared_ptr<const FaultIdentity> fault;  ///< null: there was none
  bool begins = false;
  BenchTime t;
  std::uint64_t seen = 0, dropped = 0, changed = 0, delayed = 0;  ///< so far, as Fault::Counters
  SampleLease event;  ///< the same as text for people; empty where the recorder has all that there are
  explicit operator bool() const noexcept { return fault != nullptr; }
};

class FaultInjector {
 public:
  /// So many faults can be there at a time, live ones included.
  static constexpr std::size_t kMost = 24;
  /// So many live faults that are over are remembered each by itself; earlier ones as a sum.
  static constexpr std::size_t kRemembered = 64;
  struct Earlier {
    std::uint64_t faults = 0, begins = 0, seen = 0, dropped = 0, changed = 0, delayed = 0;
  };

  /// Reads `faults` of a channel's keys. Throws ConfigError. What was there before is forgotten.
  void configure(const FaultSubject& subject, std::uint64_t seed, const ConfigNode& params);
  /// Before each run.
  void arm();
  /// Setup or loop thread; no allocation.
  void start(BenchTime t0, Period loop_period) noexcept;
  /// Gives back what faults hold; live ones are refused until the next arm. The loop has ended; the thread
  /// that injects need not have.
  void stop() noexcept;

  [[nodiscard]] const FaultSubject& subject() const noexcept { return subject_; }
  [[nodiscard]] const std::vector<std::unique_ptr<Fault>>& scheduled() const noexcept { return scheduled_; }
  /// Of the thread that injects; after the run, of any.
  [[nodiscard]] const std::vector<std::unique_ptr<Fault>>& live() const noexcept { return live_; }

  /// What the live faults came to that are no longer in `live`. Of the same threads.
  [[nodiscard]] const Earlier& earlier() const noexcept { return earlier_; }

  /// A live fault, to be given to `add`. Setup thread, or the one thread that injects while a run goes on.
  /// bad_input, unavailable (there are too many), wrong_state (the run has ended). It belongs to the
  /// injector, for as long as it is not `left`.
  [[nodiscard]] Result<Fault*> make_live(const ConfigNode& node);
  /// A live fault of an earlier run, to come again at the same instants. Before start.
  [[nodiscard]] Status schedule_live(const ConfigNode& node, std::uint32_t index, Duration from,
                                     Duration until);
  /// What a fault needs to be applied, memory for example; called by make_live. Set by whoever applies them.
  std::function<Status(FaultKind)> make_room;

  // Loop thread, noexcept, no allocation.
  void add(Fault* live) noexcept;
  void end_live() noexcept;
  /// Once a cycle; a second call with the same `now` does nothing.
  void begin_cycle(BenchTime now) noexcept;
  [[nodiscard]] std::span<Fault* const> active() const noexcept { return {active_.data(), active_.size()}; }
  /// The next begin or end of a fault.
  [[nodiscard]] FaultChange poll_change() noexcept;

 private:
  [[nodiscard]] std::unique_ptr<Fault> make(FaultReading reading, std::uint32_t index, bool live) const;
  [[nodiscard]] bool wanted(Fault& f, Duration elapsed) const noexcept;
  void forget_oldest();
  void switch_on(Fault& f, BenchTime now) noexcept;
  void switch_off(Fault& f, BenchTime now) noexcept;
  void tell(const Fault& f, bool begins, BenchTime now) noexcept;

  FaultSubject subject_;
  std::uint64_t seed_ = 0;
  std::mutex live_mutex_;  ///< make_live against stop; never the running loop
  bool ended_ = false;     ///< guarded by live_mutex_
  std::vector<std::unique_ptr<Fault>> scheduled_, live_;
  Earlier earlier_;
  std::uint32_t next_index_ = 0;

  // the run
  BenchTime t0_, cycle_;
  Period period_ = milliseconds(1);
  bool running_ = false, any_cycle_ = false;
  std::vector<Fault*> all_, active_;
  std::unique_ptr<SamplePool> event_pool_;
  FixedRing<FaultChange, 2 * kMost> changes_;
  std::uint64_t event_sequence_ = 0;
};

// What a fault decides of one sample. Loop thread.
/// By its probability.
[[nodiscard]] bool fault_hits(const Fault& f, std::uint64_t sequence) noexcept;
/// burst_loss: whether the sample is lost; calls in the order of sequence.
[[nodiscard]] bool burst_loses(Fault& f, std::uint64_t sequence) noexcept;
/// delay, jitter: how long after its release it is handed on.
[[nodiscard]] Duration fault_delay(const Fault& f, std::uint64_t sequence) noexcept;
/// timestamp, clock_skew, clock_step: what is added to a time of capture.
[[nodiscard]] Duration fault_clock_offset(const Fault& f, BenchTime t_capture) noexcept;
/// bias, drift, noise, spike, corrupt.
[[nodiscard]] SampleEdit fault_edit(const Fault& f, std::uint64_t sequence, BenchTime t) noexcept;

}  // namespace rigor
