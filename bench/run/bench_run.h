// One run of a rig: the loop, its ports, and what is remembered of it for the report.
//
//   cycle k at t      inputs    every source is polled, every port advances, what is new goes to the recorder
//                     motion    the bench's world takes up what the channels say of its joints
//                     capture   simulators and triggered cameras are told to measure at t
//                     app       the application sees the ports and gives commands
//                     outputs   commands go to the recorder (the sinks have them already)
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bench/expect/expectations.h"
#include "bench/motion/bench_motion.h"
#include "bench/run/input_digest.h"
#include "bench/run/recorded_events.h"
#include "bench/run/run_outcome.h"
#include "rt-core/executive.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/record/frame_tree.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

namespace live {
class LiveTap;
}
namespace plant {
class Plant;
}
class EmulatorProcess;
class FaultBench;
struct RunBridge;
class PairSource;
class Recorder;
struct SensorTimes;
class VisibilityScript;

/// One channel in a run.
struct RunChannel {
  const ChannelEntry* entry = nullptr;
  std::unique_ptr<Source> source;
  PairSource* pair = nullptr;  ///< `source`, where it is one
  std::string replaced_by;     ///< virtual time: what stands in for the device; empty: nothing does
  SamplePort port;
  std::uint32_t recorder_id = 0;
  const VisibilityScript* script = nullptr;  ///< replay: what the port has to show

  // Written by the loop, read when it has ended.
  SampleLease first_image;
  std::size_t next_switch = 0;  ///< of the pair's schedule
  Histogram age;                ///< t_cycle − t_capture when a sample became visible
  Histogram arrival;            ///< t_arrival − t_capture
  static constexpr std::size_t kKept = 256;
  std::array<Gap, kKept> gaps{};
  std::size_t gap_count = 0;
  std::array<StatusSpan, kKept> spans{};
  std::size_t span_count = 0;
  std::array<DifferenceAt, kKept> differences{};  ///< of a pair, a few times a second
  std::size_t difference_count = 0;
  BenchTime t_first, t_last;  ///< captures of the first and last visible sample
  std::uint64_t last_sequence = 0;
  std::uint64_t before_start = 0;  ///< samples that were captured before the run, and not shown
  std::uint64_t taken = 0;         ///< samples that the loop took from the source, these included
  bool seen = false;
  PortStatus last_status = PortStatus::never;
  bool listed = false;  ///< in the recording's first cycle
};

struct RunSink {
  const SinkEntry* entry = nullptr;
  std::unique_ptr<Sink> sink;
  std::unique_ptr<CommandPort> port;
  std::string replaced_by;
  std::uint64_t made_safe = 0;  ///< times, as the loop knows
};

/// What the loop works on. Filled by the assembly, then given to `BenchRun`.
struct RunParts {
  RigConfig rig;
  std::vector<std::unique_ptr<RunChannel>> channels;
  std::vector<std::unique_ptr<RunSink>> sinks;
  std::unique_ptr<Application> application;
  std::unique_ptr<Expectations> expectations;       ///< null: the rig has none
  std::shared_ptr<FaultBench> faults;               ///< null: a replay, which shows what came of them
  std::vector<RecordedFault> recorded_faults;       ///< of a replay, in order of time: when they were on
  const EmulatorProcess* emulators = nullptr;       ///< that this run brought up; null: none
  std::vector<std::shared_ptr<RunBridge>> bridges;  ///< none in a replay
  BenchMotion motion;
  /// Where the rig's frames stand; null: the rig has none, or does not want them told.
  std::shared_ptr<const record::FrameTree> frames;
  std::vector<std::string> frames_assumed;  ///< sensors' frames of which nobody says where they are
  std::filesystem::path recording;          ///< of a replay: its file, which has the frames; else empty
  std::vector<std::shared_ptr<Platform>> platforms;   ///< of this process: they set out when the run starts
  std::vector<std::shared_ptr<plant::Plant>> plants;  ///< of this process: armed before all channels
  /// Of simulated sensors, by the names of their channels (of a pair NAME.simulated).
  std::vector<std::pair<std::string, std::shared_ptr<const SensorTimes>>> sensor_times;
  /// Keeps alive what sources point to (worlds, renderers, device models, workers).
  std::vector<std::shared_ptr<void>> keep;
};

/// The loop of a run. Setup thread constructs and calls; `run` blocks.
class BenchRun final : private ExecutiveHooks {
 public:
  /// `trace` may be null.
  BenchRun(RunParts& parts, Trace* trace);
  ~BenchRun() override;

  /// Configures ports and application, arms channels and the loop. unavailable: `stop` said so meanwhile.
  [[nodiscard]] Status arm(StopToken stop = {});
  /// What the channels found when they were armed.
  [[nodiscard]] std::vector<std::string> warnings() const;
  /// Of the channels (Channel::forecasts).
  [[nodiscard]] std::vector<std::string> forecasts() const;
  /// Before arm: whether what the application sees is digested. False at first.
  void want_digest(bool wanted) { digest_wanted_ = wanted; }
  /// Between arm and run; null: nothing is recorded. A run that cannot be recorded is over.
  void set_recorder(Recorder* recorder);
  /// Between arm and run; null: nobody looks on.
  void set_live(live::LiveTap* tap) { live_ = tap; }
  /// Virtual time: at most so many seconds of bench time in a second; 0: as fast as it goes.
  void set_pace(double pace) { pace_ = pace; }
  /// Replay: cycles for which this returns false are not run by the application, as in the recorded run.
  void set_cycle_filter(std::function<bool(std::uint64_t)> ran) { ran_ = std::move(ran); }
  /// Sets up this thread as the loop, tells everybody when the run begins, and runs until the duration is
  /// over or `stop` says so. Without `t0` it begins kLead after that (wall), or at 0 (virtual). A given one
  /// is that of a replay or a test; in wall time it lies in the future.
  [[nodiscard]] Result<RunOutcome> run(StopToken stop, std::optional<BenchTime> t0 = {});
  /// Virtual time, in place of `run`, for whoever looks at the ports between cycles: begin, advance until it
  /// says that the run is over, end.
  [[nodiscard]] Status begin(BenchTime t0);
  [[nodiscard]] bool advance(std::uint64_t cycles, StopToken stop) {
    return executive_.advance(cycles, stop);
  }
  [[nodiscard]] RunOutcome end();
  /// Between cycles: the instant of the next one.
  [[nodiscard]] BenchTime next_cycle_time() const noexcept {
    return t0_ + parts_.rig.loop.period * static_cast<std::int64_t>(counters().cycle.load());
  }
  /// What the application sees. Between cycles, by the thread that advances.
  [[nodiscard]] const ApplicationPorts& ports() const { return ports_; }
  /// Any thread: when the run began or begins; empty while nobody knows.
  [[nodiscard]] std::optional<BenchTime> t0() const noexcept { return origin_.get(); }
  /// Stops every channel; the first error is returned, all are stopped.
  [[nodiscard]] Status stop();

  [[nodiscard]] const LoopCounters& counters() const { return executive_.counters(); }
  [[nodiscard]] Heartbeat& heartbeat() { return heartbeat_; }
  [[nodiscard]] Executive& executive() { return executive_; }

 private:
  /// Between publishing t0 and t0: time for every channel's thread to see it (RunOrigin::kLook), on a busy
  /// machine, too.
  static constexpr Duration kLead = milliseconds(50);

  [[nodiscard]] Status arm_channels(StopToken stop);
  [[nodiscard]] Status start_channels(BenchTime t0);
  [[nodiscard]] RunOutcome outcome_of(RunSummary summary);
  void before_cycle(BenchTime t) override;
  void cycle_begin(const CycleContext& cycle) noexcept override;
  [[nodiscard]] bool in_charge() const noexcept override {
    return !parts_.application || parts_.application->in_charge();
  }

  void inputs(const CycleContext& cycle) noexcept;
  void take_up_faults(const CycleContext& cycle) noexcept;
  void take_up_notes(const CycleContext& cycle) noexcept;
  void take_up_made_safe(std::size_t sink, const CycleContext& cycle) noexcept;
  void show(RunChannel& channel, std::uint32_t index, const CycleContext& cycle) noexcept;
  void capture(const CycleContext& cycle) noexcept;
  void application(const CycleContext& cycle) noexcept;
  void run_application(const CycleContext& cycle) noexcept;
  void outputs(const CycleContext& cycle) noexcept;
  void note_differences(const CycleContext& cycle) noexcept;
  void take_up_bridged_commands(const CycleContext& cycle) noexcept;

  RunParts& parts_;
  void keep_pace(BenchTime t);

  Recorder* recorder_ = nullptr;
  std::vector<Recorder*> recorders_;  ///< that one, and those of bridges
  live::LiveTap* live_ = nullptr;
  double pace_ = 0;
  MonotonicTime began_;    ///< of the run, for its pace
  Duration cpu_at_begin_;  ///< of the process
  Heartbeat heartbeat_;
  Executive executive_;
  std::unique_ptr<InputDigest> digest_;
  bool digest_wanted_ = false;
  std::function<bool(std::uint64_t)> ran_;
  ApplicationPorts ports_;
  BenchTime t0_;
  RunOrigin origin_;  ///< t0_ for other threads than the loop
  std::uint64_t next_cycle_ = 0;
  bool skip_this_cycle_ = false;
  std::uint64_t next_note_ = 0, note_every_ = 100;
  std::size_t next_recorded_fault_ = 0;
  std::unique_ptr<SamplePool> event_pool_;
  std::uint64_t event_sequence_ = 0;
};

}  // namespace rigor
