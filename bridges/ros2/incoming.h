// Commands of other programs to sinks of the rig.
//
//   commands:
//     /cmd_vel:
//       type: geometry_msgs/Twist
//       sink: drive
//       values: { speed_mps: linear.x, turn_radps: angular.z }   value of the sink: number of the message
//       scale: { turn_radps: 1 }             factor; 1
//       limits: { speed_mps: [-1, 1] }
//       beyond: reject                       or clamp; of a value beyond its limits
//       timeout_ms: 500                      0: none
//       on_timeout: { speed_mps: 0, turn_radps: 0 }
//       qos: reliable
//
// A thread of the bridge reads and checks; what it accepts waits in a ring for the loop. Of several that come
// in one cycle the newest is given. A message of another type, a number that is none (NaN, infinity) or is
// beyond its limits, and one without what `values` names are rejected, counted, and the reason is kept.
#pragma once

#include <atomic>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "bridges/ros2/participant.h"
#include "bridges/ros2/payload.h"
#include "bridges/ros2/values.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/bridge.h"

namespace rigor::ros2 {

struct CommandSettings {
  std::string topic, type;  ///< type: full
  std::string definition;
  std::uint32_t sink = 0;
  std::string sink_name;
  Qos qos;
  struct Value {
    std::string name, path;  ///< an empty path: `constant`
    double constant = 0, scale = 1;
    double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();
    double on_timeout = 0;
  };
  std::vector<Value> values;  ///< in the order of the sink's
  bool clamp = false;
  Duration timeout;  ///< 0: none
};

/// One entry of `commands`. Throws ConfigError.
[[nodiscard]] CommandSettings read_command(const ConfigNode& n, const std::string& topic,
                                           const BridgeRig& rig);

/// A message to a command.
class CommandConverter {
 public:
  /// bad_input: a path leads to no number of the type.
  [[nodiscard]] static Result<CommandConverter> make(const CommandSettings& settings);
  struct Converted {
    BridgeCommand command;
    bool clamped = false;
  };
  /// protocol, bad_input (a value that may not be commanded), with the reason. One thread at a time.
  [[nodiscard]] Result<Converted> convert(record::Bytes message);

 private:
  CommandConverter(const CommandSettings& settings, ValueReader reader)
      : settings_(settings), reader_(std::move(reader)), numbers_(reader_.paths().size()) {}
  CommandSettings settings_;
  ValueReader reader_;
  std::vector<double> numbers_;
};

class Incoming {
 public:
  explicit Incoming(std::vector<CommandSettings> settings) : settings_(std::move(settings)) {}
  ~Incoming();
  /// Setup context.
  [[nodiscard]] Status open(const std::shared_ptr<Participant>& participant);
  void close();
  /// Loop thread; as Bridge::poll.
  [[nodiscard]] bool poll(BenchTime now, BridgeCommand& command) noexcept;
  /// Any thread but the loop's.
  [[nodiscard]] std::vector<BridgeReport::Commands> report() const;
  [[nodiscard]] std::vector<std::string> problems() const;
  /// Publishers of a topic; none: there is no such topic.
  [[nodiscard]] std::optional<std::uint32_t> peers(const std::string& topic) const;

 private:
  struct Topic {
    explicit Topic(CommandConverter c) : converter(std::move(c)) {}
    CommandConverter converter;
    std::unique_ptr<Reader> reader;
    SpscRing<CommandConverter::Converted> ring{64};
    std::atomic<std::uint64_t> received{0}, accepted{0}, rejected{0}, superseded{0}, dropped{0}, clamped{0},
        timeouts{0};
    std::string last_rejection;  ///< guarded by mutex_
    std::uint32_t closed_peers = 0;
    // Loop thread.
    BenchTime last;
    bool seen = false, timed_out = false;
  };
  void work();
  void take(Topic& topic);

  std::vector<CommandSettings> settings_;
  std::vector<std::unique_ptr<Topic>> topics_;
  std::unique_ptr<Waiter> waiter_;
  std::thread thread_;
  std::atomic<bool> stopping_{false};
  std::size_t next_ = 0;  ///< loop thread: the topic that poll looks at next
  mutable std::mutex mutex_;
  std::vector<std::string> closed_problems_;
};

}  // namespace rigor::ros2
