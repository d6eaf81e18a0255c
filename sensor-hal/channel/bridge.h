// A bridge: how programs that are no part of a rig follow its runs and command it. What a recording of the
// run would hold leaves the process as messages, while the run goes on, and commands come in:
//
//   bridges:
//     ros2: { domain: 0, commands: { /cmd_vel: { type: geometry_msgs/Twist, sink: drive, … } } }
//
//   loop ──ring──▶ a Recorder ──▶ MessageWriter of the bridge ──▶ other programs
//   sinks ◀── poll ◀──ring── threads of the bridge ◀── their commands
//
// The bench gives each bridge a Recorder of its own (sensor-hal/record/recorder.h), whose thread encodes the
// messages and hands them to the writer that the bridge makes. So a bridge has the topics of a recording,
// whichever they are.
//
// Lifecycle: configure (setup, opens nothing) → open (setup, before the run; once) → poll in every cycle
// (loop) → close (setup, after the run).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "rt-core/time.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

namespace record {
class MessageWriter;
}

/// What a bridge must know of the run that it serves.
struct BridgeRig {
  struct Sink {
    std::string name;
    std::vector<std::string> value_names;  ///< what a command to it holds, in this order
  };
  std::string name;                   ///< of the rig
  std::vector<std::string> channels;  ///< names
  std::vector<Sink> sinks;
};

/// A command that came in and was accepted.
struct BridgeCommand {
  std::uint32_t sink = 0;  ///< index in BridgeRig::sinks
  std::uint32_t count = 0;
  std::array<double, 16> value{};
};

/// What became of the messages and commands of a bridge. Each number is read by itself.
struct BridgeReport {
  struct Topic {
    std::string topic, type, qos;
    std::uint64_t messages = 0;  ///< that the run had for it: accepted + dropped
    std::uint64_t accepted = 0;  ///< by the transport
    std::uint64_t dropped = 0;   ///< the transport had no room: a peer does not keep up
    std::uint32_t peers = 0;     ///< subscribers at this moment, or when it was closed
  };
  struct Commands {
    std::string topic, type, sink;
    std::uint64_t received = 0;    ///< accepted + rejected + superseded + dropped
    std::uint64_t accepted = 0;    ///< given to the sink
    std::uint64_t rejected = 0;    ///< no message of its type, or a value that may not be commanded
    std::uint64_t superseded = 0;  ///< a newer one came in the same cycle
    std::uint64_t dropped = 0;     ///< the loop did not take them
    std::uint64_t clamped = 0;     ///< of those accepted: a value was moved to its limit
    std::uint64_t timeouts = 0;    ///< times that the values of `on_timeout` were given
    std::uint32_t peers = 0;       ///< publishers
    std::string last_rejection;    ///< why; empty: none was rejected
  };
  std::vector<Topic> topics;
  std::vector<Commands> commands;
  /// One sentence each: peers that could not be matched, and what helps.
  std::vector<std::string> problems;
};

class Bridge {
 public:
  virtual ~Bridge() = default;
  /// Setup context: reads the keys of the bridge and opens nothing. May throw ConfigError; keys of `params`
  /// that it did not ask for are refused by the caller.
  [[nodiscard]] virtual Status configure(const ConfigNode& params, const BridgeRig& rig) = 0;
  /// Setup context, configured: whether it wants the samples of this channel. What it does not want is
  /// neither encoded nor held.
  [[nodiscard]] virtual bool wants_channel(const std::string& name) const = 0;
  /// Setup context, once, before the run: joins its network. The writer takes the messages of the run, on a
  /// thread of its caller's; it must not outlive the bridge. Errors: unavailable, timeout (a peer that the
  /// configuration waits for did not come), bad_input.
  [[nodiscard]] virtual Result<std::unique_ptr<record::MessageWriter>> open(bool virtual_time) = 0;
  /// Setup context, after the writer knows all topics and before the run: returns when the peers are there
  /// that the configuration waits for. Errors: timeout; unavailable, `stop` said so.
  [[nodiscard]] virtual Status wait_for_peers(StopToken stop) = 0;
  /// Loop thread, in each cycle until it returns false: the next command, of each topic at most the newest.
  /// Wait-free, no allocation.
  [[nodiscard]] virtual bool poll(BenchTime now, BridgeCommand& command) noexcept = 0;
  /// Setup context, after the last message: leaves the network.
  virtual void close() = 0;
  /// Any thread but the loop's, from `open` on.
  [[nodiscard]] virtual BridgeReport report() const = 0;
};

}  // namespace rigor
