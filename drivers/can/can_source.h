// A CAN interface as a channel: raw frames, or signals of a DBC file.
//
// A thread of its own reads the socket. Capture is the interface's own stamp where it has one, else the
// kernel's (CLOCK_REALTIME, tied to the bench clock anew every 100 ms), which is the interrupt after the
// frame's end; `time` chooses (frame_clock.h). A sample whose frame lacked the stamp of this channel is
// marked kClockUnsure. Stamps of one channel increase, by 1 ns where the stamps of its frames do not.
//
//   can_frame            each frame that passes the filters is a sample; error frames, too, unless `errors:
//   false` registers, no rate   each frame with one of the signals is a sample; the others keep their last
//   value registers, rate_hz   the latest values at t0 + k·period; an instant without the interface is lost
//
// The socket is read from arm on. Frames of before the run are neither samples nor logged, but signals take
// their values from them, and bus-off is noticed.
//
// Frames that the socket had no room for are counted by the kernel and are `lost` here. An interface that
// goes down or away takes `connected` with it; it is looked for with growing pauses, from 50 ms to 2 s.
// Bus-off is not connected either, until the controller takes part again: by the kernel's own restart-ms, or
// `restart_ms` here, which asks by netlink (CAP_NET_ADMIN). Frames of the bench's own programs are seen as
// well.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "drivers/can/can_settings.h"
#include "drivers/can/can_socket.h"
#include "drivers/can/candump_log.h"
#include "drivers/can/error_frame.h"
#include "rt-core/deadline.h"
#include "rt-core/epoch.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::can {

/// Counts beside `health()`: protocol_errors are error frames, retries are restarts that were asked for.
class CanSource final : public StreamSource {
 public:
  ~CanSource() override;
  [[nodiscard]] std::vector<std::string> warnings() const override;
  /// Any thread: how many frames had which stamp.
  [[nodiscard]] const FrameClock& frame_clock() const noexcept { return clock_; }
  /// Any thread: the controller's state as error frames told it.
  [[nodiscard]] BusState bus_state() const noexcept { return bus_state_.load(std::memory_order_relaxed); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  [[nodiscard]] Status open();
  void run();
  [[nodiscard]] bool wait(MonotonicTime until) noexcept;
  void read_all();
  void take(const ReceivedFrame& r);
  void take_error(const CanFrame& frame);
  void link_lost();
  void try_again();
  void count_drops();
  void sample_at(BenchTime t, std::uint64_t index);
  void give(SampleSlot&& slot, const FrameClock::Placed& placed);

  SourceSettings settings_;
  RawSocket socket_;
  SignalTable table_;
  LogWriter log_;
  Deadline stop_;
  std::thread thread_;
  std::vector<ReceivedFrame> batch_;
  std::vector<std::string> warnings_;
  std::atomic<BusState> bus_state_{BusState::unknown};
  FrameClock clock_;
  EpochPair epoch_;
  MonotonicTime epoch_until_, restart_at_, next_look_;
  BenchTime last_capture_;
  Backoff backoff_;
  std::uint64_t index_ = 0, drops_seen_ = 0;
  bool link_is_up_ = false;
};

}  // namespace rigor::can
