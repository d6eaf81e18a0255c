// A pair: a real device and its simulated side, measuring at the same instants. Either is handed on; the
// other runs along.
//
//   real        ●k ──────arrives             ●k+1 ── lost ──         ●k+2 ──
//   simulated            renders for          asked for the instant   …
//                        t_capture of k       that is overdue
//   handed on            at t_capture + latency, from the side that is active then
//
// The simulated side renders for the real sample's own instant, so both have the same times and the same
// sequence, and a switch leaves no gap in either. The configured latency must therefore cover the real
// sample's way to the bench and the rendering after it. When the real side is overdue the simulated side is
// asked for the predicted instant, so that the simulated side never starves.
//
// Sequence k counts the instants of the pair: the first real sample gets round((t − t0 − phase)/period), each
// later one at least one more, by its distance from the one before; so a device clock that drifts does not
// slip a count.
//
// A sample is handed on, and shown to the observer, at its release, not before: that is where a switch can
// still take effect for it. A real sample that is missing is not replaced by the simulated one behind
// anyone's back: the port says `overdue`. In virtual time the real side's samples count as arrived at their
// release, and the simulated side renders then.
//
// What the real side tells (it is gone, it is back, it refuses) is told by the pair, whichever side is handed
// on: the event's code plus kEventOfRealSide, its text begins with the side's name. Losses, retries and
// reconnections of both sides count as the pair's own, and as lost what a device's clock that was set back
// puts before the sample handed on last; `connected` is that of the side handed on, and that of
// the device is told by side(PairSide::real).
//
// Keys:
//   active: real          real | simulated, at the start
//   overdue_ms:            after a predicted instant; default half the latency. Wall time.
//   phase_us: 0            of the instants predicted before the first real sample
//   real: {…}, simulated: {…}    the sides' own keys
#pragma once

#include <array>
#include <atomic>
#include <memory>

#include "rt-core/fixed_ring.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/pair_statistics.h"
#include "sensor-hal/channel/side_switch.h"
#include "sensor-hal/channel/simulated_source.h"

namespace rigor {

/// Sees the samples of both sides (the recorder does). Loop thread; real-time.
class PairObserver {
 public:
  virtual ~PairObserver() = default;
  virtual void on_side_sample(PairSide side, const SampleLease& sample) noexcept = 0;
  /// A window of a pair that is watched has ended: an event with the bytes of a PairWindow
  /// (pair_monitor.h).
  virtual void on_window(const SampleLease& window) noexcept { (void)window; }
};

/// EventInfo::code of a switch; `value` is 0 for real, 1 for simulated.
inline constexpr std::uint32_t kEventPairSwitch = 1;
/// Added to the code of an event that the real side tells, so that it is not taken for the pair's own.
inline constexpr std::uint32_t kEventOfRealSide = 0x10000;

class PairSource final : public Source {
 public:
  /// Configures, arms, starts and stops both sides by itself; they are in state created.
  PairSource(std::unique_ptr<Source> real, std::unique_ptr<FollowerSource> simulated, WorkerPool& workers);
  ~PairSource() override;

  /// Setup; null: nobody. Must outlive the run.
  void observe(PairObserver* observer) noexcept { observer_ = observer; }
  /// Setup, before arm: look for changes of the device against its simulated side (docs/pair-watch.md).
  /// Alarms are events.
  void watch(std::unique_ptr<PairMonitor> monitor);
  /// Null: nobody watches.
  [[nodiscard]] PairMonitor* monitor() const noexcept { return monitor_.get(); }

  void begin_cycle(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll_event() noexcept override;
  void complete_until(BenchTime now) override;
  [[nodiscard]] std::vector<std::string> warnings() const override;
  [[nodiscard]] std::vector<std::string> forecasts() const override { return simulated_->forecasts(); }
  [[nodiscard]] HealthSnapshot health() const noexcept override;

  /// Any thread: hand on this side from the next cycle on.
  void switch_to(PairSide side) noexcept { switch_.want(side); }
  /// Any thread: the side that is handed on now.
  [[nodiscard]] PairSide active() const noexcept { return switch_.active(); }
  /// Loop thread: the side that the sample handed on last came from.
  [[nodiscard]] PairSide handed_side() const noexcept { return handed_side_; }
  /// Any thread.
  [[nodiscard]] PairSnapshot statistics() const noexcept { return statistics_.snapshot(); }
  [[nodiscard]] std::uint64_t switches() const noexcept { return switch_.count(); }
  [[nodiscard]] const Source& side(PairSide s) const noexcept {
    return s == PairSide::real ? *real_ : static_cast<const Source&>(*simulated_);
  }

 private:
  static constexpr std::size_t kPending = 64;
  struct SideState {
    FixedRing<SampleLease, kPending> pending;
    SampleLease last_due;  ///< the newest whose release has come
    bool any_due = false;
    std::uint64_t last_due_index = 0;

    [[nodiscard]] bool push(SampleLease&& s) noexcept;
    [[nodiscard]] const SampleLease* due(BenchTime now) const noexcept;
  };

  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

  [[nodiscard]] SideState& state_of(PairSide s) noexcept { return sides_[static_cast<std::size_t>(s)]; }
  [[nodiscard]] BenchTime predicted(std::uint64_t index) const noexcept;
  void take_in(BenchTime now) noexcept;
  void take_real(SampleLease&& sample) noexcept;
  void request_simulated(std::uint64_t index, BenchTime t_capture) noexcept;
  void request_overdue(BenchTime now, Duration margin) noexcept;
  void new_cycle(BenchTime now) noexcept;
  void tell_switch(PairSide to, BenchTime now) noexcept;
  void sample_due(PairSide side, const SampleLease& sample) noexcept;
  [[nodiscard]] SampleLease deliver(PairSide side, const SampleLease& sample) noexcept;
  void take_notes() noexcept;
  void pass_on_events() noexcept;
  bool tell(BenchTime now, const EventInfo& info) noexcept;

  std::unique_ptr<Source> real_;
  std::unique_ptr<FollowerSource> simulated_;
  std::unique_ptr<PairMonitor> monitor_;
  PairStatistics statistics_;
  PairObserver* observer_ = nullptr;

  // configuration
  Period period_;
  Duration latency_, overdue_, phase_;
  PairSide initial_ = PairSide::real;

  // the run
  bool virtual_time_ = false;
  bool running_ = false;
  SideSwitch<> switch_;
  std::array<SideState, 2> sides_;
  SampleLease ahead_;  ///< virtual time: a real sample whose release has not come
  BenchTime cycle_;
  bool any_cycle_ = false;
  BenchTime t0_;
  // The grid of instants: index and instant of the newest real sample, or of the grid's origin.
  std::uint64_t anchor_index_ = 0;
  BenchTime anchor_t_;
  bool any_real_ = false;
  std::uint64_t next_simulated_ = 0;
  BenchTime last_simulated_t_;
  bool any_handed_ = false;
  std::uint64_t last_handed_ = 0;
  BenchTime last_handed_t_;
  PairSide handed_side_ = PairSide::real;
  SampleLease after_switch_;
  /// Not handed on in this run: captured no later than the last one, or still held by the device's source.
  std::atomic<std::uint64_t> misplaced_{0};

  std::unique_ptr<SamplePool> event_pool_;
  FixedRing<SampleLease, 16> events_;
  std::uint64_t event_sequence_ = 0;
};

}  // namespace rigor
