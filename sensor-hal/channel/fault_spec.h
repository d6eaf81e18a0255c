// What can be made to go wrong with a channel, as rigs and the command line write it.
//
//   faults:
//     - { kind: drop, probability: 0.2, from_s: 10, until_s: 12 }
//     - { kind: bias, value: position, amount: 1.5, when: { channel: table, value: position, above: 30 } }
//     - { kind: delay, delay_ms: 80, every_s: 5, for_s: 0.5 }
//
//   kind           keys of its own                                        what it does to a sample
//   drop           probability                                            it is lost
//   burst_loss     share, mean_burst                                      losses come in runs
//   (Gilbert–Elliott) delay          delay_ms, probability                                  handed on so long
//   after its release jitter         shape, min_ms, max_ms, mean_ms, sigma_ms, probability  the same, by a
//   random time stuck          freeze                                                 the first one again and
//   again bias           value, amount[_UNIT], probability                      a value is off by so much
//   drift          value, rate[_UNIT]_per_s                               a value goes off with time
//   noise          value, sigma[_UNIT], probability                       a value has Gaussian noise more
//   spike          value, amount[_UNIT], probability, share               a value jumps up or down
//   corrupt        flips, keep, flagged, probability                      bits flip, the end is missing
//   timestamp      offset_ms, probability                                 its time of capture is wrong
//   clock_skew     ppm                                                    the device's clock runs fast or
//   slow clock_step     step_ms                                                the device's clock is off by
//   so much disconnect                                                            the device is gone
//   slow_consumer  mode: unread | hold, leases                            samples are not read, or are kept
//
// Which kinds fit depends on what the channel carries; what a value is called and in which unit it is stated,
// see fault_values.h. Sources know all kinds, sinks those that a command can suffer: drop, burst_loss, delay,
// jitter, stuck, bias, drift, noise, spike, disconnect.
//
// When it is on: from `from_s` until `until_s` after the start of the run; with `every_s`, `for_s` long in
// each such period; with `when`, while a register or pose of another channel is `above` or `below` a number,
// or that channel `is: overdue` or `is: disconnected` (in the cycle before), and with `for_s` beside it so
// long from each time that this becomes true. `probability` is that of each sample while it is on.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/channel/channel.h"

namespace rigor {

enum class FaultKind : std::uint8_t {
  drop,
  burst_loss,
  delay,
  jitter,
  stuck,
  bias,
  drift,
  noise,
  spike,
  corrupt,
  timestamp,
  clock_skew,
  clock_step,
  disconnect,
  slow_consumer
};
inline constexpr std::size_t kFaultKinds = 15;
[[nodiscard]] std::string_view fault_kind_name(FaultKind kind);
[[nodiscard]] std::optional<FaultKind> fault_kind_named(std::string_view name);

/// EventInfo::code of the begin and the end of a fault; `value` is its index in its channel. The text is for
/// people, and is cut where it is too long; programs read `/rigor/faults` (see FaultChange).
inline constexpr std::uint32_t kEventFaultBegin = 16, kEventFaultEnd = 17;
/// The same of a fault that was asked for while the run went on.
inline constexpr std::uint32_t kEventLiveFaultBegin = 18, kEventLiveFaultEnd = 19;

/// One signal in the frames of a bus: where it is, so that a fault can change it. Any thread, no allocation.
class FrameSignal {
 public:
  virtual ~FrameSignal() = default;
  /// NaN: this frame does not show it.
  [[nodiscard]] virtual double read(const CanFrame& frame) const noexcept = 0;
  /// False, and nothing changed, where the signal cannot hold the value.
  virtual bool write(CanFrame& frame, double value) const noexcept = 0;
};
/// `node`: the fault, whose key `dbc` names the file; throws ConfigError.
using FrameSignalFinder =
    std::function<std::shared_ptr<const FrameSignal>(const ConfigNode& node, const std::string& name)>;

/// What a fault is to be read for.
struct FaultSubject {
  std::string channel;
  SampleKind kind = SampleKind::none;  ///< of a sink register_block
  bool is_sink = false;
  const ChannelDescription* description = nullptr;
  FrameSignalFinder find_signal;  ///< may be empty: frames then have raw bytes only
};

struct FaultTrigger {
  enum class When : std::uint8_t { always, above, below, overdue, disconnected } when = When::always;
  std::string channel, value;
  double threshold = 0;
  bool operator==(const FaultTrigger&) const = default;
};

enum class JitterShape : std::uint8_t { uniform, exponential, normal };

/// A fault as it was asked for. What is not of its kind keeps its default.
struct FaultSpec {
  FaultKind kind = FaultKind::drop;

  Duration from{};  ///< after the start of the run
  Duration until = Duration(std::numeric_limits<std::int64_t>::max());
  Duration every{}, on_for{};  ///< 0: without
  FaultTrigger trigger{};
  double probability = 1;

  double share = 0, mean_burst = 1;  ///< burst_loss
  Duration delay{};                  ///< delay; the offset of timestamp, the step of clock_step
  JitterShape shape = JitterShape::uniform;
  Duration jitter_a{}, jitter_b{};  ///< uniform: from, to; exponential: mean; normal: mean, sigma
  bool freeze = false;              ///< stuck
  std::string value{}, unit{};      ///< which value, and the unit that its keys have; empty: the only one
  std::string dbc{};                ///< the file that names `value`
  double amount = 0;                ///< bias, spike; sigma of noise; of drift per second
  std::optional<double> element_share{};  ///< spike: of pixels, points; none for what has no elements
  std::uint32_t flips = 0;                ///< corrupt: bits
  double keep = 1;                        ///< corrupt: share of the bytes that came
  bool flagged = true;                    ///< corrupt: the receiver noticed
  double ppm = 0;
  bool hold = false;  ///< slow_consumer
  std::uint32_t leases = 0;
  bool operator==(const FaultSpec&) const = default;
};

/// A fault that was read, with what its names stand for.
struct FaultReading {
  FaultSpec spec;
  int component = 0;  ///< see fault_values.h
  std::shared_ptr<const FrameSignal> signal;
  ConfigNode node;  ///< for messages at arm
};

/// The key of a number in the unit of a value: `amount_m`, `rate_m_per_s`.
[[nodiscard]] std::string fault_key(std::string key, const std::string& unit, const char* after = "");

/// Reads one fault. Throws ConfigError: an unknown kind with the nearest, a kind that does not fit, keys.
/// `live`: asked for while a run goes on: it begins at once, so that of a schedule it has only `for_s`. Setup
/// context.
[[nodiscard]] FaultReading read_fault(const ConfigNode& node, const FaultSubject& subject, bool live = false);

// The same the other way, the kind first and then what differs from the defaults: read_fault reads it back to
// an equal struct. Setup context.
/// As an object of JSON: what programs get, and what a recording holds.
[[nodiscard]] std::string fault_json(const FaultSpec& fault);
/// As YAML in one line, for people: "{kind: drop, probability: 0.2}".
[[nodiscard]] std::string fault_yaml(const FaultSpec& fault);
/// What read_fault reads, from an object of JSON. bad_input; `where` says where it came from.
[[nodiscard]] Result<ConfigNode> fault_node(std::string_view json, const std::string& where);

}  // namespace rigor
