// An emulated node on a real CAN interface (can, vcan, vxcan).
//
//   emulators:
//     table: { backend: can, interface: vcan0, create: true, dbc: table.dbc, node: Turntable, model:
//     turntable }
//
// Keys: interface; create (makes a vcan interface of that name; CAP_NET_ADMIN); dbc with node or messages,
// bind, change_check_ms; replay, repeat; log; bitrate and data_bitrate (virtual time). Messages leave at
// absolute instants of the node's grid; frames that the interface has no room for are counted as lost.
#pragma once

#include <memory>
#include <mutex>
#include <thread>

#include "drivers/can/can_socket.h"
#include "drivers/can/emulated_node.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::can {

/// `health()`: connected while the interface is up, received frames with commands, lost frames that could not
/// be sent, reconnects.
class CanEmulator final : public Emulator {
 public:
  ~CanEmulator() override;
  void attach(DeviceParts parts) override;
  [[nodiscard]] std::string endpoint() const override;
  /// Any thread; zeros before the first start.
  [[nodiscard]] EmulatedNode::Counters counters() const;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  [[nodiscard]] Status open();
  void run();
  [[nodiscard]] bool send(const CanFrame& frame);
  void read_all();
  void log_frame(const CanFrame& frame, std::uint8_t fd_flags, RealtimeTime t);

  DeviceParts parts_;
  NodeSettings settings_;
  std::unique_ptr<EmulatedNode> node_;
  RawSocket socket_;
  LogWriter log_;
  Deadline stop_;
  std::thread thread_;
  std::vector<ReceivedFrame> batch_;
  Backoff backoff_;
  mutable std::mutex counters_mutex_;
  EmulatedNode::Counters counters_;
  bool link_is_up_ = false;
};

}  // namespace rigor::can
