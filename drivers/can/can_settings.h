// The keys of CAN channels, sinks and emulators, and what they mean for frames. Shared by the real side and
// the one in virtual time, so that both read the same keys and present the same values.
//
//   channels:
//     bus:   { kind: can_frame, backend: can, interface: can0, filters: [{id: 0x100, mask: 0x700}], fd: true
//     } table: { kind: registers, backend: can, interface: can0, rate_hz: 100, dbc: table.dbc,
//              signals: [{message: TableState, signal: position, name: position}] }
//   sinks:
//     motor: { backend: can, interface: can0, dbc: table.dbc, signals: [{message: TableCommand, signal:
//     enable}],
//              safe: {enable: 0} }
//
// Parsing: setup context, throws ConfigError. SignalTable and CommandFrames: one thread, no allocation once
// made.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/can/can_bits.h"
#include "drivers/can/dbc.h"
#include "drivers/can/frame_clock.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::can {

/// One signal that a channel or sink names.
struct NamedSignal {
  const Message* message = nullptr;  ///< of the settings' DBC
  std::size_t signal = 0;
  std::string name;
  [[nodiscard]] const Signal& of() const { return message->signals[signal]; }
};

struct SourceSettings {
  std::string interface;
  std::vector<Filter> filters;  ///< frames that pass any; none: all frames
  bool fd = false;              ///< CAN FD frames, too
  bool errors = true;           ///< raw channels: error frames as samples
  Duration restart;             ///< ask the kernel to restart the controller so long after bus-off; 0: never
  std::size_t slots = 0;
  int receive_buffer_bytes = 0;    ///< 0: the system's
  std::filesystem::path log;       ///< candump log of what came; empty: none
  std::shared_ptr<const Dbc> dbc;  ///< of signals; null: raw frames
  std::vector<NamedSignal> signals;
  std::vector<Duration> timeouts;  ///< of each signal; 0: a value never grows too old
  bool sampled = false;            ///< signals: at the channel's rate; else on arrival
  std::optional<StampKind> time;   ///< none: by the interface where it can, else by the kernel

  [[nodiscard]] bool raw() const noexcept { return !dbc; }
  [[nodiscard]] static SourceSettings parse(const ChannelConfig& config, ChannelDescription& description);
};

/// The latest values of a channel's signals.
class SignalTable {
 public:
  SignalTable() = default;
  explicit SignalTable(const SourceSettings& settings);
  /// True when the frame has one of the signals; of those that it shows the values are taken.
  bool take(const CanFrame& frame, BenchTime t) noexcept;
  /// Values at `now`: NaN before the first and after their timeout; the sample is then marked kIncomplete.
  void fill(Sample& sample, BenchTime now) const noexcept;
  void clear() noexcept;

 private:
  struct Group {  ///< the signals of one message
    const Message* message;
    std::vector<std::pair<std::size_t, std::size_t>> signals;  ///< in the message, in the channel
  };
  std::vector<Group> groups_;
  std::vector<double> values_;
  std::vector<BenchTime> seen_;
  std::vector<Duration> timeouts_;
};

/// How a message of a sink leaves.
struct CommandMessage {
  const Message* message = nullptr;
  Duration period;  ///< 0: with each command alone
  CanFrame start;   ///< with constants and start values
};

struct SinkSettings {
  std::string interface;
  std::shared_ptr<const Dbc> dbc;
  std::vector<NamedSignal> signals;
  std::vector<std::optional<double>> safe;  ///< in the order of `signals`
  std::vector<CommandMessage> messages;
  bool announce = true;  ///< a command of a cyclic message also leaves at once

  [[nodiscard]] static SinkSettings parse(const ChannelConfig& config, ChannelDescription& description);
};

/// The frames that a sink's messages have now.
class CommandFrames {
 public:
  CommandFrames() = default;
  explicit CommandFrames(const SinkSettings& settings);
  /// All or nothing: false where a value does not fit, and the frames are as before.
  [[nodiscard]] bool apply(const Command& command) noexcept;
  /// The signals of `safe` to their values, the others as they are.
  void make_safe() noexcept;
  [[nodiscard]] const std::vector<CanFrame>& frames() const noexcept { return frames_; }

 private:
  struct Place {
    std::size_t frame, signal;
  };
  [[nodiscard]] bool put(const std::vector<double>& values) noexcept;
  const SinkSettings* settings_ = nullptr;
  std::vector<CanFrame> frames_, next_;
  std::vector<std::vector<double>> by_message_;  // NaN: untouched
  std::vector<Place> places_;
  std::vector<double> values_;
};

/// A message that an emulated node sends.
struct NodeMessage {
  const Message* message = nullptr;
  Duration period;  ///< 0: when a value changes
};

struct NodeSettings {
  std::string interface;
  BitRates rates;
  bool create = false;  ///< makes a vcan interface of that name where there is none
  std::shared_ptr<const Dbc> dbc;
  std::vector<NodeMessage> messages;
  std::vector<std::pair<std::string, std::string>> bind;  ///< signal of the DBC, signal of the model
  Duration change_check = milliseconds(10);
  std::filesystem::path replay;  ///< candump log that is sent in place of messages
  bool repeat = false;
  std::filesystem::path log;

  /// `params` are the emulator's; keys that others read (`model`, `signals`, …) are left to them.
  [[nodiscard]] static NodeSettings parse(const ConfigNode& params);
};

[[nodiscard]] std::string read_interface(const ConfigNode& n);

}  // namespace rigor::can
