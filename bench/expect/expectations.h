// What a rig expects of its run, judged while the loop goes round and when it has ended.
//
//   expect:
//     - { of: right, rate_hz: { min: 4.9 }, missing: { max: 0 }, age_ms: { max: 260 } }      a channel
//     - { of: turntable.position, value: { min: -45, max: 45 }, per_s: { max: 60 }, from_s: 1 }  a value of a
//     channel
//     - { of: table_command.target_rate, value: { max: 60 } }                                or of a sink's
//     commands
//     - { of: table_command, failed: { max: 0 } }                                            a sink
//     - { of: left, alarm: false }                                                           a watched pair
//     - { of: estimate, against: truth, position_m: { max: 0.2 }, until_s: 9 }               an estimate
//     - { of: drive, safe_after_ms: { max: 200 }, when: { fault: scan } }                  a sink, when
//     something went wrong
//     - { of: loop, skipped: { max: 0 }, wake_p99_us: { max: 500 } }
//     - { of: application, late: { max: 0 } }
//
// Each quantity with its bounds is one expectation. `from_s` and `until_s` count from the start of the run;
// of sinks, loop and application the whole run is judged. An expectation for which nothing came does not
// hold.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bench/expect/expected.h"
#include "rt-core/executive.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// What is known of a run beside what its cycles were like.
struct RunEnd {
  enum class Extent : std::uint8_t {
    run,        ///< all of it, when it has ended
    recording,  ///< of sinks and application nothing, and of the loop only what it skipped
    so_far      ///< while it goes on: `sinks`, `alarms`, and of the loop `skipped` and `misses`
  } extent = Extent::run;
  struct Sink {
    std::string name;
    std::uint64_t failed = 0, late = 0, dropped = 0;
  };
  struct Alarm {
    std::string pair;
    double t_s = 0;
  };
  const RunSummary* loop = nullptr;              ///< of a run that has ended
  std::optional<std::uint64_t> skipped, misses;  ///< cycles; where `loop` is null
  std::vector<Sink> sinks;
  std::vector<Alarm> alarms;
  std::optional<ApplicationFacts> application;
};

class Expectations {
 public:
  /// Null where the rig expects nothing. bad_input with the place: a name that the rig does not have, a
  /// quantity that it does not have there, bounds the wrong way round. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<Expectations>> read(const RigConfig& rig);
  ~Expectations();

  /// After channels and sinks were configured: finds values by their names. bad_input with the place, also of
  /// a channel or sink that is not among the ports. Setup context.
  [[nodiscard]] Status bind(const ApplicationPorts& ports);

  /// Whether any of them waits for a fault.
  [[nodiscard]] bool need_faults() const noexcept;

  // Loop thread; no allocation. In each cycle what happened in it, and `cycle` last.
  void begin(BenchTime t0) noexcept;
  /// A fault of a channel or sink, of a pair's side `left.real`, is on from this cycle on, or off.
  void fault(std::string_view of, FaultKind kind, bool begins) noexcept;
  /// The sink has its safe values, because nobody commanded it.
  void made_safe(const CommandPort& port, BenchTime t) noexcept;
  void command(const CommandPort& port, const Command& command) noexcept;
  void cycle(BenchTime t) noexcept;

  /// In the order of the rig. Setup context, after the last cycle.
  [[nodiscard]] std::vector<Expected> finish(const RunEnd& end);

  // For who looks on. Any thread but the loop's, while it goes round, and afterwards.
  /// The loop shows at the end of its next cycle what it has seen by then. Wait-free.
  void ask() noexcept;
  /// What comes of what it showed last; nothing is known before. `known`: its extent is so_far.
  [[nodiscard]] std::vector<Expected> so_far(const RunEnd& known) const;
  /// Setup thread, after the last cycle: shows all that was seen.
  void show() noexcept;

 private:
  struct Check;
  struct Board;
  Expectations();
  std::vector<std::unique_ptr<Check>> checks_;
  std::unique_ptr<Board> board_;
  BenchTime t0_;
};

}  // namespace rigor
