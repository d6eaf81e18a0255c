// An application: a step in the loop that sees channels and gives commands, and cannot tell which of them are
// real.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>

#include "rt-core/port.h"
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
  std::map<std::string, InputPort, std::less<>> inputs;
  std::map<std::string, CommandPort*, std::less<>> outputs;
};

class Application {
 public:
  virtual ~Application() = default;
  /// Setup thread: reads its keys, finds its ports, takes all memory it will need.
  [[nodiscard]] virtual Status configure(ConfigNode params, const ApplicationPorts& ports,
                                         Period loop_period) = 0;
  /// Loop thread, once a cycle after the inputs: no allocation, no lock, no blocking call.
  virtual void step(std::uint64_t cycle, BenchTime t_cycle) noexcept = 0;
  /// Setup thread, once after the last step: ends its threads, writes what it has to say. An error fails
  /// the run.
  [[nodiscard]] virtual Status finish() { return {}; }
};

}  // namespace rigor
