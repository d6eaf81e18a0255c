// An application: a step in the loop that sees channels and gives commands, and cannot tell which of them are
// real.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "rt-core/histogram.h"
#include "rt-core/port.h"
#include "rt-core/stop.h"
#include "sensor-hal/channel/channel.h"

namespace rigor {

using SamplePort = Port<Sample>;

/// Where an application puts its commands. Logical execution time holds for them too: a command of the cycle
/// at t is applied at t + latency, however early it was computed.
class CommandPort {
 public:
  CommandPort(std::string name, Sink& sink, Duration latency)
      : name_(std::move(name)), sink_(&sink), latency_(latency) {}

  /// Loop thread, wait-free. `values` in the order of the sink's description; what is beyond 16 is refused.
  /// False: the ring to the sink is full, the command is lost and counted.
  bool send(BenchTime t_cycle, std::span<const double> values) noexcept {
    Command c;
    c.sequence = next_sequence_++;
    c.t_issue = t_cycle;
    c.t_effect = t_cycle + latency_;
    if (values.size() > c.value.size()) return false;
    c.count = static_cast<std::uint32_t>(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) c.value[i] = values[i];
    last_ = c;
    has_new_ = true;
    return sink_->command(c);
  }
  /// Runner: the command of this cycle, once.
  [[nodiscard]] const Command* take_new() noexcept {
    if (!has_new_) return nullptr;
    has_new_ = false;
    return &last_;
  }
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] const ChannelDescription& describe() const noexcept { return sink_->describe(); }

 private:
  std::string name_;
  Sink* sink_;
  Duration latency_;
  std::uint64_t next_sequence_ = 0;
  Command last_;
  bool has_new_ = false;
};

/// A channel as the application sees it.
struct InputPort {
  std::string name;
  const ChannelDescription* description = nullptr;
  const SamplePort* port = nullptr;
};

struct ApplicationPorts {
  StopToken stop{};  ///< of the run, for whoever waits in setup or in virtual time
  std::map<std::string, InputPort, std::less<>> inputs;
  std::map<std::string, CommandPort*, std::less<>> outputs;
};

/// How an application kept up that is called in turns (a process, a shared object). Every sample that became
/// visible is in one of the last four.
struct ApplicationFacts {
  std::uint64_t turns = 0;       ///< that it was given
  std::uint64_t answered = 0;    ///< of these
  std::uint64_t late = 0;        ///< answers that were not there at their deadline
  std::uint64_t skipped = 0;     ///< turns that were due and not given: it was still busy, or not there
  std::uint64_t restarts = 0;    ///< how often it was started again
  std::uint64_t delivered = 0;   ///< samples in turns; those that were shown again after a restart count once
  std::uint64_t superseded = 0;  ///< pictures and scans not shown, for a newer one came before its turn
  std::uint64_t dropped = 0;     ///< samples not shown: it was away for too long, or was started again
  std::uint64_t after_last = 0;  ///< that became visible after the last turn
  Histogram answer;              ///< from turn to answer
};

class Application {
 public:
  virtual ~Application() = default;
  /// Setup thread: reads its keys, finds its ports, takes all memory it will need.
  [[nodiscard]] virtual Status configure(ConfigNode params, const ApplicationPorts& ports,
                                         Period loop_period) = 0;
  /// Loop thread, once a cycle after the inputs: no allocation, no lock, no blocking call.
  virtual void step(std::uint64_t cycle, BenchTime t_cycle) noexcept = 0;
  /// Loop thread, after `step`: the run cannot go on; `finish` says why.
  [[nodiscard]] virtual bool failed() const noexcept { return false; }
  /// Loop thread, after `step`. False: nobody commands the sinks now; they do what they do when the loop
  /// falls silent, until it is true again.
  [[nodiscard]] virtual bool in_charge() const noexcept { return true; }
  /// Of one that is called in turns. Setup thread, after the last step.
  [[nodiscard]] virtual std::optional<ApplicationFacts> facts() const { return std::nullopt; }
  /// Setup thread, once after the last step: ends its threads, writes what it has to say. An error fails
  /// the run.
  [[nodiscard]] virtual Status finish() { return {}; }
};

}  // namespace rigor
