// Whether a run was good: what went wrong in it, how badly, and what helps. One judgement for the terminal,
// `--json`, the report, the live view and `--fail-on`.
//
//   RunFacts (run_facts.h fills them) ── judge ──▶ Verdict: findings, the worst first
//
//   bad      right: 109 of 250 pictures, 97 of them late; a picture takes 64 ms of its 40 ms period;
//            use `--clock virtual` or `--set channels.right.rate_hz=10`
//   warning  left: 201 of 250 pairs compared
//   note     loop: 12 of 10000 cycles missed their instant
//
// Which findings there are and where a note becomes a warning: docs/verdict.md.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "bench/expect/samples_due.h"
#include "rt-core/period.h"
#include "rt-core/result.h"
#include "sensor-hal/channel/application.h"

namespace rigor {

/// What a finding is about; names for `--fail-on` and JSON in `finding_names`.
enum class FindingKind : std::uint8_t {
  expect,       ///< what the rig expects did not hold
  lost,         ///< samples that were due never became visible
  late,         ///< samples arrived after their release
  silent,       ///< a channel gives nothing (any more) when the run ends
  emulator,     ///< the run's own emulator process died
  alarm,        ///< the watch of a pair raised an alarm
  uncompared,   ///< of a pair nothing, or less than due, was compared
  skipped,      ///< cycles of the loop were left out
  missed,       ///< cycles began late or took too long
  command,      ///< commands failed, came late, or found no place
  application,  ///< the application's process answered late, was left out, or was started again
  recording,    ///< the recorder had to drop samples
  digest,       ///< the input digest is not known
  warning,      ///< what a channel warned of
  bridge        ///< a bridge dropped messages, rejected commands, or could not be matched with a peer
};
inline constexpr std::size_t kFindingKinds = 15;
[[nodiscard]] const char* name_of(FindingKind kind) noexcept;

enum class Severity : std::uint8_t { note, warning, bad };
[[nodiscard]] const char* name_of(Severity severity) noexcept;

/// A set of finding kinds.
class FindingSet {
 public:
  void add(FindingKind k) { bits_ |= 1U << static_cast<unsigned>(k); }
  [[nodiscard]] bool has(FindingKind k) const { return (bits_ >> static_cast<unsigned>(k) & 1U) != 0; }
  [[nodiscard]] bool empty() const { return bits_ == 0; }
  [[nodiscard]] FindingSet both(FindingSet o) const {
    o.bits_ &= bits_;
    return o;
  }
  [[nodiscard]] std::vector<std::string> names() const;

 private:
  unsigned bits_ = 0;
};
/// Of the words of `--fail-on`. bad_input with the names that there are.
[[nodiscard]] Result<FindingSet> findings_named(const std::vector<std::string>& names);

struct Finding {
  FindingSet kinds;
  Severity severity = Severity::warning;
  std::string channel;   ///< or sink; empty: of the run
  std::string sentence;  ///< begins with the channel's name
  std::string cure;      ///< empty: none is known
  /// Sentence and cure.
  [[nodiscard]] std::string text() const;
};

struct PairFacts {
  std::uint64_t compared = 0, real_missing = 0, simulated_missing = 0;
  Duration capture{};        ///< mean time to compute a sample of the simulated side; 0: not known
  double alarm_s = 0;        ///< where there is an alarm
  std::string alarm_text{};  ///< empty: none
};
struct ChannelFacts {
  std::string name;
  std::string noun = "samples";  ///< what one of them is called, plural: pictures, scans
  Period period;                 ///< 0: aperiodic
  Duration latency;
  std::optional<std::uint64_t> due;  ///< samples whose release lay in the run; none: aperiodic
  std::uint64_t delivered = 0;       ///< that became visible, those that a newer one overtook included
  std::uint64_t late = 0;
  std::uint64_t lost = 0;         ///< by the gaps in their sequence
  bool silent = false;            ///< gives nothing any more
  std::optional<double> last_s;   ///< capture of the last visible sample; none: nothing came
  double gone_s = 0;              ///< for how long it was lost, all in all
  Duration capture;               ///< mean time to compute one, of a simulated channel; 0: not known
  bool emulated = false;          ///< the device is an emulator of this run, on this machine
  Duration arrival;               ///< 99th percentile from capture to arrival; 0: not known
  std::uint64_t by_faults = 0;    ///< samples that injected faults took
  std::optional<PairFacts> pair;  ///< of a pair
  /// What is due and did not become visible.
  [[nodiscard]] std::uint64_t missing() const;
  /// Over the whole run; 0 where nothing was due.
  [[nodiscard]] double rate_hz() const;
};
struct SinkFacts {
  std::string name;
  std::uint64_t accepted = 0, late = 0, failed = 0, dropped = 0;
};
struct BridgeFacts {
  std::string name;
  std::uint64_t messages = 0;  ///< that were to leave, those included that were dropped
  std::uint64_t dropped = 0;
  std::uint64_t commands = 0, rejected = 0;
  std::string last_rejection;
  std::vector<std::string> problems;  ///< peers that were not matched, a sentence each
};
struct RunFacts {
  std::optional<ApplicationFacts> application;  ///< of one in a process of its own
  bool wall_clock = true;
  int workers = 1;  ///< threads of the simulated sensors
  std::uint64_t cycles = 0, skipped = 0, misses = 0;
  std::vector<ChannelFacts> channels;
  std::vector<SinkFacts> sinks;
  std::vector<BridgeFacts> bridges;
  std::string emulators;  ///< how the run's own emulators died; empty: they did not
  std::uint64_t recording_dropped = 0;
  bool digest_known = true;
  std::vector<std::string> unmet;     ///< what the rig expects and what came instead, a sentence each
  std::vector<std::string> warnings;  ///< of channels
};

struct Verdict {
  std::vector<Finding> findings;  ///< the worst first
  /// note: the run is good.
  [[nodiscard]] Severity worst() const;
  /// Of `wanted` those that were found.
  [[nodiscard]] FindingSet found(FindingSet wanted) const;
};

[[nodiscard]] Verdict judge(const RunFacts& facts);

}  // namespace rigor
