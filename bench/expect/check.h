// One expectation: what it looks at, within which bounds, and what it has seen. For this room alone.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bench/expect/expectations.h"
#include "bench/expect/safe_state.h"
#include "bench/motion/pose_error.h"
#include "rt-core/numbers.h"
#include "rt-core/published.h"
#include "sensor-hal/channel/fault_spec.h"

namespace rigor {
namespace expect {

enum class Quantity : std::uint8_t {
  rate_hz,
  missing,
  late,
  age_ms,
  age_p99_ms,  // of a channel
  value,
  per_s,  // of a value
  failed,
  late_commands,
  dropped,  // of a sink
  wake_p50_us,
  wake_p99_us,
  wake_max_us,
  cycle_p99_us,
  skipped,
  misses,  // of the loop
  late_answers,
  skipped_turns,
  restarts,
  answer_p99_ms,  // of the application
  position_m,
  yaw_deg,        // of an estimate
  safe_after_ms,  // of a sink, when something went wrong
  alarm           // of a pair
};
enum class Subject : std::uint8_t { channel, value, sink, loop, application, estimate, reaction };

struct Bounds {
  std::optional<double> min, max;
  [[nodiscard]] bool hold(double v) const { return !(min && !(v >= *min)) && !(max && !(v <= *max)); }
  [[nodiscard]] std::string text() const {
    if (min && max) return fmt::format("from {} to {}", *min, *max);
    return min ? fmt::format("of at least {}", *min) : fmt::format("of at most {}", *max);
  }
};

/// What went wrong: a fault of a channel or sink is on, or a channel is overdue or disconnected.
struct Wrong {
  std::string name;  ///< of a fault also `left.real`; `left` has those of its sides, too
  bool fault = true, disconnected_alone = false;
  std::optional<FaultKind> kind;  ///< none: any
  /// "after a fault of left", "when left is disconnected".
  [[nodiscard]] std::string text() const;
  [[nodiscard]] bool is_of(std::string_view of, FaultKind what) const noexcept {
    return fault && (!kind || *kind == what) && of.starts_with(name) &&
           (of.size() == name.size() || of[name.size()] == '.');
  }
};

/// What a check has seen of its run so far. Plain data.
struct Seen {
  bool begun = false;
  BenchTime t0;  ///< of the run
  BenchTime t_first, t_last;
  PortCounters first, last;
  std::uint64_t looked_at = 0, outside = 0;
  double minimum = 0, maximum = 0, first_s = kNaN, age_p99_ms = kNaN;
  SafeState::Seen safe_state;
};

}  // namespace expect

struct Expectations::Check {
  Expected expected;  ///< what it is, without what came of it
  ConfigNode node;
  expect::Subject subject{};
  expect::Quantity quantity{};
  expect::Bounds bounds;
  bool wanted_alarm = false;
  Duration from, until;  ///< until 0: the end
  std::string name, value_name, against;

  // Bound.
  const SamplePort* port = nullptr;
  const CommandPort* commands = nullptr;
  SampleKind kind = SampleKind::none;
  std::size_t index = 0;
  Period period;
  Duration latency;
  std::optional<std::size_t> x, y, yaw, state;  ///< places in the estimate's command

  expect::Wrong wrong;  ///< of a reaction
  std::vector<std::pair<std::string, double>> safe_values;
  std::optional<expect::SafeState> safe_state;  ///< bound

  // Of the loop.
  expect::Seen seen;
  std::uint32_t faults_on = 0;
  double previous = kNaN;
  BenchTime t_previous;
  Histogram ages;
  std::array<PlanePose, 64> estimates{};  ///< that no truth lies behind yet, oldest first
  std::size_t estimate_count = 0;
  std::array<PlanePose, 2> truths{};  ///< the last ones
  std::size_t truth_count = 0;

  [[nodiscard]] bool in_window(Duration since_start) const {
    return since_start >= from && (until.ns() == 0 || since_start <= until);
  }
  void look(double v, Duration since_start) noexcept {
    if (seen.looked_at++ == 0) seen.minimum = seen.maximum = v;
    seen.minimum = std::min(seen.minimum, v);
    seen.maximum = std::max(seen.maximum, v);
    if (bounds.hold(v)) return;
    if (seen.outside++ == 0) seen.first_s = since_start.seconds();
  }
  void take(double v, BenchTime t, Duration since_start) noexcept {
    if (quantity == expect::Quantity::value) look(v, since_start);
    if (quantity == expect::Quantity::per_s && std::isfinite(previous) && t > t_previous)
      look((v - previous) / (t - t_previous).seconds(), since_start);
    previous = v;
    t_previous = t;
  }
  void take_sample(Duration since_start) noexcept;
  void take_truth(BenchTime t0) noexcept;
  void add_estimate(const Command& c) noexcept;
  [[nodiscard]] bool is_wrong() const noexcept;
  /// All that it has seen.
  [[nodiscard]] expect::Seen account() const noexcept;
  /// What comes of that. Any thread.
  [[nodiscard]] Expected outcome(const expect::Seen& s, const RunEnd& run) const;

 private:
  void judge(Expected& e, const expect::Seen& s, const RunEnd& run) const;
  void judge_reaction(Expected& e, const expect::Seen& s, const RunEnd& run) const;
  [[nodiscard]] std::uint64_t due(const expect::Seen& s) const;
  [[nodiscard]] bool decided_so_far(const Expected& e, const expect::Seen& s) const;
};

/// What each check has seen, for other threads than the loop's.
struct Expectations::Board {
  std::vector<std::unique_ptr<Published<expect::Seen>>> seen;  ///< in the order of the checks
  std::atomic<bool> asked{false};
};

}  // namespace rigor
