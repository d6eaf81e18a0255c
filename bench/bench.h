// The bench as a library: a rig, run from one's own program or test, with what came of it as a struct.
//
//   const auto rig = rigor::load_rig("demo.yaml");
//   if (!rig) return complain(rig.error().text());
//   auto bench = rigor::Bench::create(*rig, rigor::make_registry());    // builtin/registry.h
//   if (!bench) return complain(bench.error().text());
//   if (auto ready = (*bench)->prepare(); !ready) …                     // devices open, everything armed
//   rigor::Result<rigor::RunReport> report = (*bench)->run();
//   report->passed(); report->facts.channels; report->text();
//
// In virtual time also cycle by cycle, with the ports between them:
//
//   if (auto started = (*bench)->start(); !started) …
//   auto more = (*bench)->step(10);
//   for (; more && *more; more = (*bench)->step(10)) look_at((*bench)->ports().inputs.at("left"));
//   auto report = (*bench)->finish();
//
// One thread makes, prepares and runs a bench; in wall-clock time it is the loop's thread while `run` lasts.
// Other threads may call what says so, and nothing else. Several benches may be in one process, in virtual
// time also at once. Functions throw nothing; they return errors that say where, what was expected, what came
// and what to do. No signal is handled. Warnings of channels go where `BenchOptions` says; on standard error
// there is one line where a file of an earlier run is renamed, or a process that the bench started dies.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bench/result/run_report.h"
#include "rt-core/epoch.h"
#include "rt-core/stop.h"
#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

namespace live {
class Server;
}
struct ReplayInput;

/// How a rig is run, beside what it says itself.
struct BenchOptions {
  bool replace = false;                 ///< files of an earlier run; false: they are kept under a number
  std::filesystem::path trace{};        ///< of the loop, for ui.perfetto.dev; empty: none
  std::filesystem::path junit{};        ///< what the rig expects, as JUnit's XML; empty: none
  std::filesystem::path faults_from{};  ///< a recording of this rig whose live faults come again; empty: none
  bool start_emulators = true;          ///< wall-clock time: those of the rig, in a process `rigor emulate`
  bool control = false;                 ///< the run answers `rigor fault` and `rigor pair`
  std::optional<bool> digest{};         ///< of what the application sees; none: in virtual time, or recorded
  double pace = 0;                      ///< virtual time: at most so many seconds in a second; 0: no limit
  FindingSet fail_on{};                 ///< findings of the verdict that fail the run
  live::Server* live = nullptr;         ///< shows how it goes; null: nobody looks on
  bool live_stays = false;              ///< after a run that finished, until the bench goes
  std::function<void(const std::string&)> on_warning = {};  ///< of channels, as they come up; and forecasts
};

class Bench {
 public:
  /// Puts the rig's channels, sinks and application together; opens no device, writes no file. bad_input: the
  /// rig, or a file to be written that cannot be or is one of its inputs. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<Bench>> create(RigConfig rig, const Registry& registry,
                                                             BenchOptions options = {});
  /// The same with a recording in place of devices and simulated sensors, in virtual time. A run that shows
  /// the application something else than was recorded is not passed.
  [[nodiscard]] static Result<std::unique_ptr<Bench>> create_replay(RigConfig rig, const Registry& registry,
                                                                    ReplayInput input,
                                                                    BenchOptions options = {});
  /// The recorded rig with `overrides`, on the channels of its recording, for an application of one's own in
  /// `registry`: what `rigor replay` does. Nothing is recorded, and no program or plugin that the recording
  /// names is run: replace it by an override, "application={…}". not_found, protocol; bad_input: not a
  /// recording of a run.
  [[nodiscard]] static Result<std::unique_ptr<Bench>> create_replay(
      const std::filesystem::path& recording, const Registry& registry, BenchOptions options = {},
      const std::vector<ConfigOverride>& overrides = {});
  /// Closes the devices; what was recorded is whole.
  ~Bench();
  Bench(const Bench&) = delete;
  Bench& operator=(const Bench&) = delete;

  /// Brings up the emulators, opens and arms all devices, takes all memory, opens the recording. Returns when
  /// all of them are ready. unavailable: `stop` said so meanwhile.
  [[nodiscard]] Status prepare(StopToken stop = {});
  /// Starts, runs until the rig's duration is over or `stop` says so, closes all, and reports. Once, after
  /// `prepare`.
  [[nodiscard]] Result<RunReport> run(StopToken stop = {});

  /// Virtual time, in place of `run`. wrong_state: not prepared, or in wall-clock time.
  [[nodiscard]] Status start();
  /// Runs so many cycles. False: the run is over, by its last cycle, `stop`, or a failure that the report
  /// has; `finish` comes next. internal: a source threw; the devices are closed, and there is no report.
  [[nodiscard]] Result<bool> step(std::uint64_t cycles = 1, StopToken stop = {});
  /// Closes all, and reports.
  [[nodiscard]] Result<RunReport> finish();

  [[nodiscard]] const RigConfig& rig() const noexcept;
  /// The channels as an application sees them, and where commands go. Between steps; empty before `prepare`.
  /// What it names lives as long as the bench.
  [[nodiscard]] const ApplicationPorts& ports() const noexcept;
  /// From the next cycle on: `{.kind = FaultKind::drop, .on_for = seconds(3), .probability = 0.2}`; `on_for`
  /// 0: until it is cleared. It begins at once: `from`, `until`, `every` and `trigger` are those of scheduled
  /// faults. Any thread, from `prepare` to the end of the run. bad_input: no such channel or sink, or a fault
  /// that does not fit it; wrong_state: no run goes on, or it is a replay; unavailable: the channel has as
  /// many faults as it can have.
  [[nodiscard]] Status inject_fault(const std::string& channel, const FaultSpec& fault);
  /// The same, as rigs write it: "{ kind: drop, probability: 0.2, for_s: 3 }".
  [[nodiscard]] Status inject_fault(const std::string& channel, const std::string& fault);
  /// Ends the live faults of one channel, or of all (empty name). As inject_fault.
  [[nodiscard]] Status clear_faults(const std::string& channel = {});
  /// The side of a pair that the application is given from the next cycle on: "real" or "simulated". As
  /// inject_fault.
  [[nodiscard]] Status switch_pair(const std::string& channel, const std::string& active);
  /// Between steps: a command as an application would give it in the next cycle, one value for each of the
  /// sink's names in their order. wrong_state; bad_input: no such sink, more or fewer values; unavailable:
  /// the sink's queue is full.
  [[nodiscard]] Status command(const std::string& sink, std::span<const double> values);
  /// Between steps: what the rig expects, and what the cycles so far say of it.
  [[nodiscard]] std::vector<Expected> expected() const;
  /// Cycles of the loop that were run or skipped so far. Any thread.
  [[nodiscard]] std::uint64_t cycle() const noexcept;

 private:
  struct Impl;
  explicit Bench(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
