// The channel: what every backend looks like to the bench, be it a device, a simulator, a recording or a
// pair.
//
// Lifecycle, the same for sources, sinks and emulators:
//
//   created ──configure──▶ configured ──arm──▶ armed ──start──▶ running ──stop──▶ configured
//
//   configure  parses the channel's own keys; touches nothing outside                setup thread
//   arm        everything slow: opens the device, starts its stream and the I/O
//              threads, takes all memory                                             setup thread
//   start      publishes t0, the instant at which the run begins                     loop thread
//   stop       ends capture, joins threads, closes the device                        setup thread
//
// An armed channel waits for t0 for as long as the other channels of the rig need to arm. Meanwhile
//   - what a free-running device measures is read and discarded, so that nothing overflows; it may teach a
//     clock map. A sample of the run was captured at t0 or later, or at most half a period before it
//     (RunOrigin::covers).
//   - what measures on the grid of t0 (pollers, triggers, recordings) waits for it.
//   - a sink keeps its device safe and does not judge the loop's heartbeat.
//   - a device that goes away is looked for as in a run: the run then begins with `connected` false.
//
// So `start` is brief: do_start creates no thread, does no I/O, takes no lock that another thread holds for
// long, and allocates nothing large. The loop calls it on its own (SCHED_FIFO) thread a few milliseconds
// before the first cycle. Emulators, and sources in virtual time, are not bound by that.
//
// Two edges more than drawn: `configure` may be called again on a configured channel, and `stop` disarms an
// armed one (another channel of the rig failed to arm). A call that the state does not allow returns
// ErrorCode::wrong_state and changes nothing. A call that fails leaves the state as it was. The non-virtual
// calls of Channel check the state; backends implement the do_* ones. do_stop must cope with a channel that
// was armed and never started, and a backend's destructor with one that was never stopped.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/period.h"
#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/channel/run_origin.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

enum class ChannelState : std::uint8_t { created, configured, armed, running };

/// What all backends share of a channel's configuration; the rest is in `params`, which the backend parses
/// itself.
struct ChannelConfig {
  std::string name;  ///< unique in the rig; pairs name their sides `left.real`, `left.simulated`
  SampleKind kind = SampleKind::none;
  Period period;           ///< 0: aperiodic
  Duration latency;        ///< capture to release: the latency of the device that is modelled
  std::uint64_t seed = 0;  ///< of the rig; a model's draws are keyed by it and by the channel's name
  ConfigNode params;       ///< this backend's own keys, with their places in the file
};

/// How a channel presents itself to applications, recorder and reports. Valid once configured.
struct ChannelDescription {
  SampleKind kind = SampleKind::none;
  std::string frame_id;       ///< sensor frame, e.g. `left_optical`
  std::size_t max_bytes = 0;  ///< of one sample; the pool's slots are made for it
  std::uint32_t width_px = 0, height_px = 0;
  PixelFormat format = PixelFormat::mono8;
  std::vector<std::string> names, units;  ///< of a register block's values, in order
};

/// What a channel says of itself: whether its device is there, and counters that only grow. Each number is
/// read by itself: those of one snapshot need not be of one instant.
struct HealthSnapshot {
  bool connected = false;
  std::uint64_t received = 0;    ///< complete samples that came from the device or simulator
  std::uint64_t incomplete = 0;  ///< samples marked kIncomplete
  std::uint64_t lost = 0;        ///< samples known to be lost before they reached the ring
  std::uint64_t no_slot = 0;     ///< dropped: every slot of the pool was held
  std::uint64_t ring_full = 0;   ///< dropped: the loop did not take them
  std::uint64_t protocol_errors = 0;
  std::uint64_t retries = 0;  ///< resends, repeated requests
  std::uint64_t reconnects = 0;
  bool operator==(const HealthSnapshot&) const = default;
};

/// What a HealthSnapshot is taken from. Written by the backend's threads, read by any.
struct HealthCounters {
  std::atomic<bool> connected{false};
  std::atomic<std::uint64_t> received{0}, incomplete{0}, lost{0}, no_slot{0}, ring_full{0};
  std::atomic<std::uint64_t> protocol_errors{0}, retries{0}, reconnects{0};

  [[nodiscard]] HealthSnapshot snapshot() const noexcept;
};

/// What arm needs to know of the run.
struct ArmContext {
  bool virtual_time = false;
  Period loop_period = milliseconds(1);
};

class Channel {
 public:
  virtual ~Channel() = default;
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  [[nodiscard]] Status configure(const ChannelConfig& config);
  [[nodiscard]] Status arm(const ArmContext& context);
  [[nodiscard]] Status start(BenchTime t0);
  [[nodiscard]] Status stop();

  [[nodiscard]] ChannelState state() const noexcept { return state_; }
  [[nodiscard]] const ChannelConfig& config() const noexcept { return config_; }
  [[nodiscard]] const ChannelDescription& describe() const noexcept { return description_; }
  /// Any thread, at any time; wait-free. A channel that stands in front of another overrides it and adds its
  /// own to what that one says.
  [[nodiscard]] virtual HealthSnapshot health() const noexcept { return health_.snapshot(); }
  /// What `arm` found that a user should know although it is no error. Setup thread, armed or running.
  [[nodiscard]] virtual std::vector<std::string> warnings() const { return {}; }
  /// What a run on the wall clock will lose by what `arm` measured, and what to set against it. It is said
  /// before the run and is no finding of it: what is lost is counted then. Setup thread, armed.
  [[nodiscard]] virtual std::vector<std::string> forecasts() const { return {}; }

 protected:
  Channel() = default;
  /// Fills `description_`. May throw ConfigError; keys of `config.params` that it did not ask for are refused
  /// by the caller.
  virtual Status do_configure(const ChannelConfig& config) = 0;
  virtual Status do_arm(const ArmContext& context) = 0;
  /// Configured: whether what is behind it (sockets, ports, devices) has no virtual time. `arm` then refuses
  /// a run in virtual time.
  [[nodiscard]] virtual bool requires_wall_clock() const noexcept { return false; }
  /// The origin is published after it, so that what it writes is visible to the threads that wait for t0.
  virtual Status do_start(BenchTime t0) {
    (void)t0;
    return {};
  }
  virtual Status do_stop() = 0;
  /// Unknown from arm until start.
  [[nodiscard]] const RunOrigin& origin() const noexcept { return origin_; }

  ChannelDescription description_;
  HealthCounters health_;

 private:
  ChannelState state_ = ChannelState::created;
  ChannelConfig config_;
  RunOrigin origin_;
};

/// Gives samples to the loop.
class Source : public Channel {
 public:
  /// Loop thread, once a cycle, before or after `poll`, increasing `now`: dispatch what is captured by the
  /// bench's own grid.
  virtual void begin_cycle(BenchTime now) noexcept { (void)now; }
  /// Loop thread: the next sample that has arrived, in order of release; empty when there is none. Its lease
  /// is the only one: a stage between device and loop takes the slot back to number the sample or to change
  /// its stamp. A pair, the last stage, does keep leases.
  [[nodiscard]] virtual SampleLease poll(BenchTime now) noexcept = 0;
  /// Loop thread: the next thing worth telling that happened to this channel (a pair was switched), as a
  /// sample of kind event; empty when there is none.
  [[nodiscard]] virtual SampleLease poll_event() noexcept { return {}; }
  /// Virtual time only, before `poll`; blocks until every sample with t_release ≤ now can be polled.
  virtual void complete_until(BenchTime now) { (void)now; }
};

/// A command on its way out: the values of a sink's registers (in the order of its description) or a CAN
/// frame. `t_effect` is its logical instant: the sink's I/O thread applies it then, not before.
struct Command {
  std::uint64_t sequence = 0;
  BenchTime t_issue;
  BenchTime t_effect;
  std::uint32_t count = 0;
  std::array<double, 16> value{};
};

/// What became of a sink's commands, up to now. Each number is read by itself.
struct SinkSnapshot {
  std::uint64_t accepted = 0, applied = 0, late = 0, failed = 0, dropped = 0, made_safe = 0;
  bool operator==(const SinkSnapshot&) const = default;
};

/// What a SinkSnapshot is taken from. Written by the loop and the sink's threads, read by any.
struct SinkCounters {
  std::atomic<std::uint64_t> accepted{0}, applied{0}, late{0}, failed{0}, dropped{0}, made_safe{0};

  [[nodiscard]] SinkSnapshot snapshot() const noexcept;
};

/// Takes commands from the loop. Once started, its I/O thread watches the loop's heartbeat by itself: when
/// the loop is stuck, gone or told to stop, the thread applies the channel's `safe:` values without being
/// asked.
class Sink : public Channel {
 public:
  /// Loop thread, wait-free. False when the ring to the I/O thread is full; the command is then lost and
  /// counted.
  [[nodiscard]] virtual bool command(const Command& command) noexcept = 0;
  /// Virtual time only: apply every command with t_effect ≤ now to the device's model.
  virtual void complete_until(BenchTime now) { (void)now; }
  /// Called at arm by the rig: where the loop's heartbeat is to be read.
  virtual void watch(const class Heartbeat* heartbeat, Duration deadline) = 0;
  /// Any thread, at any time; wait-free. Overridden as health() is.
  [[nodiscard]] virtual SinkSnapshot counters() const noexcept { return counters_.snapshot(); }

 protected:
  SinkCounters counters_;
};

}  // namespace rigor
