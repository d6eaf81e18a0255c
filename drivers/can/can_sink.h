// Commands to a CAN bus: signals of a DBC file by name.
//
// A message with a cycle (GenMsgCycleTime, or `period_ms`) is sent by the kernel's broadcast manager, which
// keeps its rhythm whatever this program does; a command changes its content and, unless `announce: false`,
// also leaves at once. A message without a cycle is sent with each command. Signals that the sink does not
// name keep `constants` or their start values.
//
// The loop pushes commands into a ring; a thread of its own applies each at its t_effect and watches the
// loop's heartbeat. The `safe:` values are sent
//   - from arm on, so that the device is in a known state before the loop starts,
//   - when the loop is silent for longer than the deadline, or says that it stopped,
//   - at stop, once more; then cyclic sending ends.
// The frames come back when they have left the interface, with the stamp of their transmission. A command is
// late when its frame left more than a cycle after its instant; one whose frame did not leave within a second
// is told at the end of the run. (The error queue of SO_TIMESTAMPING has stamps of frames that a program
// wrote itself; those of the broadcast manager come back in this way alone.)
//
// What was commanded before the loop fell silent is then thrown away. When the interface went down or away,
// the thread opens it again when it is back and sends what the device is to have by then. When this program
// dies, the kernel ends the sending with its socket: a device on a bus has to watch for that itself.
#pragma once

#include <atomic>
#include <optional>
#include <vector>

#include "drivers/can/can_settings.h"
#include "drivers/can/can_socket.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/paced_sink.h"

namespace rigor::can {

/// `health().connected`: the interface is up and takes what is sent; `received`: commands and safe values
/// that the kernel took.
class CanSink final : public PacedSink {
 public:
  ~CanSink() override;
  [[nodiscard]] std::vector<std::string> warnings() const override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void tick() override;
  void apply(const Command& command) override;
  void keep_safe() override;
  [[nodiscard]] int start_all() noexcept;
  [[nodiscard]] int send_all() noexcept;
  void failed(int error) noexcept;
  void make_safe();
  void look_at_link();
  [[nodiscard]] Status open_watcher();
  void expect_on_bus(const Command& command, bool late);
  void take_transmissions();

  SinkSettings settings_;
  CommandFrames frames_;
  BroadcastManager bcm_;
  RawSocket watcher_;  // of the interface's state, and of the frames that left
  FrameClock clock_;
  /// The frame of the last command that is to leave at once.
  struct Awaited {
    CanFrame frame;
    BenchTime t_effect, t_sent;
    bool late = false;  ///< it is counted already
  };
  std::optional<Awaited> awaited_;
  std::vector<ReceivedFrame> batch_;
  std::atomic<std::uint64_t> not_seen_{0};
  Backoff backoff_;
  MonotonicTime next_look_;
  bool link_is_up_ = false;
  bool safe_ = false;  // the frames that are sent are the safe ones
};

}  // namespace rigor::can
