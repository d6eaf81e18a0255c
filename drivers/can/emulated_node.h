// An emulated node of a CAN bus, without a bus: what it sends when, and what it does with what comes.
//
// Cyclic messages leave at t0 + k·period; the others when one of their bits has changed, which is looked for
// every `change_check`. Values come from a SignalModel, by the names of the DBC's signals (or `bind`);
// signals that the model does not have keep their start values. A multiplexor that the model does not have
// takes its values in turn. A message whose value the device does not know (NaN), or that its signal cannot
// hold, is not sent: it is counted. Received messages are written to the commanded signals of the model.
//
// In place of messages, or beside them, a candump log is sent in its own time. It is read from its file as it
// is sent: a log of an hour on a busy bus need not fit in memory. Lines that are a little out of order, as
// logs of several interfaces have them, are sent with the latest before them.
//
// One thread; `act` does not allocate.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "drivers/can/can_settings.h"
#include "drivers/can/candump_log.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::can {

class EmulatedNode {
 public:
  struct Counters {
    std::uint64_t sent = 0;      ///< frames that the bus took
    std::uint64_t failed = 0;    ///< frames that the bus did not take
    std::uint64_t unknown = 0;   ///< messages not sent: a value is not known, or does not fit
    std::uint64_t skipped = 0;   ///< instants of cyclic messages that were missed altogether
    std::uint64_t received = 0;  ///< frames with a commanded signal
    std::uint64_t refused = 0;   ///< values that the model did not take
  };
  /// bad_input where model and messages do not fit together, and for a log with a line that is none, or that
  /// goes back by more than a second. Reads all of the log.
  [[nodiscard]] static Result<std::unique_ptr<EmulatedNode>> make(const NodeSettings& settings,
                                                                  std::shared_ptr<SignalModel> model);
  void start(BenchTime t0);
  /// The instant of the next thing to do.
  [[nodiscard]] BenchTime next_event() const noexcept;
  /// Sends all that is due at `now`; `send` is false where the frame cannot leave. An instant that is missed
  /// by more than a period is skipped; the grid stays where it is.
  void act(BenchTime now, const std::function<bool(const CanFrame&)>& send);
  void receive(const CanFrame& frame, BenchTime now);
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }
  [[nodiscard]] const NodeSettings& settings() const noexcept { return settings_; }

 private:
  struct Sent {
    const Message* message = nullptr;
    Duration period;
    std::vector<int> model;  ///< of each signal: index in the model; -1: none
    std::vector<double> values;
    CanFrame frame, last;
    bool was_sent = false;
    int turning = -1;                  ///< multiplexor that takes its values in turn
    std::vector<std::uint64_t> turns;  ///< raw values
    std::size_t turn = 0;
    BenchTime next;
  };
  struct Received {
    const Message* message = nullptr;
    std::vector<std::pair<std::size_t, std::size_t>> signals;  ///< in the message, in the model
  };
  explicit EmulatedNode(NodeSettings settings, std::shared_ptr<SignalModel> model)
      : settings_(std::move(settings)), model_(std::move(model)) {}
  [[nodiscard]] Status bind();
  [[nodiscard]] int model_index(const std::string& signal) const;
  [[nodiscard]] bool compose(Sent& s, BenchTime now);
  void send_one(Sent& s, BenchTime now, const std::function<bool(const CanFrame&)>& send);

  NodeSettings settings_;
  std::shared_ptr<SignalModel> model_;
  std::vector<Sent> sent_;
  std::vector<Received> received_;
  [[nodiscard]] Status open_log();
  void next_of_log();
  std::optional<LogReader> log_;
  std::optional<LogEntry> log_next_;
  RealtimeTime log_first_;
  Duration log_length_;
  BenchTime log_start_, log_due_;  ///< of its first frame, of log_next_
  Counters counters_;
};

}  // namespace rigor::can
