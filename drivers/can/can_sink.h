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
// What was commanded before the loop fell silent is then thrown away. When the interface went down or away,
// the thread opens it again when it is back and sends what the device is to have by then. When this program
// dies, the kernel ends the sending with its socket: a device on a bus has to watch for that itself.
#pragma once

#include <memory>
#include <thread>
#include <vector>

#include "drivers/can/can_settings.h"
#include "drivers/can/can_socket.h"
#include "rt-core/deadline.h"
#include "rt-core/heartbeat.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::can {

/// `health().connected`: the interface is up and takes what is sent; `received`: commands and safe values
/// that the kernel took.
class CanSink final : public Sink {
 public:
  ~CanSink() override;
  [[nodiscard]] bool command(const Command& command) noexcept override;
  void watch(const Heartbeat* heartbeat, Duration deadline) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void run();
  void work();
  void apply(const Command& command);
  [[nodiscard]] int start_all() noexcept;
  [[nodiscard]] int send_all() noexcept;
  void failed(int error) noexcept;
  void make_safe();
  void drop_all();
  void look_at_link();

  SinkSettings settings_;
  CommandFrames frames_;
  BroadcastManager bcm_;
  RawSocket watcher_;  // of the interface's state
  Deadline deadline_;
  std::unique_ptr<SpscRing<Command>> ring_;
  const Heartbeat* heartbeat_ = nullptr;
  Duration heartbeat_deadline_ = milliseconds(100);
  Duration loop_period_ = milliseconds(1);
  std::thread thread_;
  Backoff backoff_;
  MonotonicTime next_look_;
  bool link_is_up_ = false;
  bool safe_ = false;       // the frames that are sent are the safe ones
  bool want_safe_ = false;  // they have to be
};

}  // namespace rigor::can
