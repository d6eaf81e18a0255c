// The common part of sinks in wall-clock time: the loop pushes commands into a ring, and a thread of the sink
// takes each out and applies it at its instant.
//
//   loop     command()  ──▶ ring ──▶ thread   tick()       each tick, and at each instant
//                                             apply(c)     at c.t_effect, not before
//                                             keep_safe()  while the loop is silent or over
//                                             after()
//
// What was commanded before the loop fell silent is thrown away.
#pragma once

#include <algorithm>
#include <memory>
#include <thread>

#include "rt-core/deadline.h"
#include "rt-core/heartbeat.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/channel.h"

namespace rigor {

/// Whoever derives from it calls `stop_thread` in `do_stop`, and `stop` in its destructor where it is not
/// stopped.
class PacedSink : public Sink {
 public:
  [[nodiscard]] bool command(const Command& command) noexcept final;
  void watch(const Heartbeat* heartbeat, Duration deadline) final;

 protected:
  /// Setup thread, at arm, before all others: an empty ring. `tick`: how long a command may wait there before
  /// the thread looks; the loop does not wake it, for a system call on the loop's side would cost more.
  /// Errors: of the system's timers.
  [[nodiscard]] Status open_ring(Duration loop_period, Duration tick = microseconds(500));
  /// Setup thread, at arm, last.
  void start_thread();
  /// Setup thread: joins the thread, where there is one, and drops what waits.
  void stop_thread();
  [[nodiscard]] bool has_thread() const noexcept { return thread_.joinable(); }
  /// Whether an instant is longer past than a cycle, or two ticks where those are longer: too late for a
  /// command.
  [[nodiscard]] bool is_late(Duration past) const noexcept {
    return past > std::max(loop_period_, tick_ * 2);
  }
  /// The thread, and who stands in for it: the commands that take effect by `now`, in the order of the ring.
  /// False: the loop was lost meanwhile.
  bool apply_until(BenchTime now);

  // The thread calls these.
  virtual void tick() {}
  virtual void apply(const Command& command) = 0;
  virtual void keep_safe() = 0;
  virtual void after() {}

  bool want_safe_ = false;  ///< the loop is silent or over

 private:
  void run();
  void work();
  [[nodiscard]] bool loop_is_lost() const noexcept;
  void drop_all();

  std::unique_ptr<SpscRing<Command>> ring_;
  const Heartbeat* heartbeat_ = nullptr;
  Duration heartbeat_deadline_ = milliseconds(100);
  Duration loop_period_ = milliseconds(1), tick_ = microseconds(500);
  Deadline deadline_;
  std::thread thread_;
};

}  // namespace rigor
