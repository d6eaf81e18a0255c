// From a receiver's bytes to solutions, satellites and pulses with their place on the bench clock. No socket,
// no thread: the source over a line, recordings and virtual time share it.
//
// A solution is placed by
//   device   the receiver's own time, tied down by the quickest arrivals, which come `output_delay` after the
//            instant that they are of (drivers/lidar/packet_clock.h)
//   utc      the receiver's date and this machine's CLOCK_REALTIME (NTP, PTP, or this receiver by gpsd)
//   arrival  the arrival of its first message less `output_delay`
//   fixed    a constant is added to the receiver's time (recordings, virtual time)
// A line that was held up lets its messages go at once. Whoever reads them learns nothing of the receiver's
// clock: an arrival counts that came as long after the one before as the receiver's own time went on.
//
// Edges of the time pulse, where the bench sees them, tie `device` down to microseconds (`take_edge`).
#pragma once

#include <functional>
#include <optional>
#include <utility>

#include "drivers/gnss/epoch_assembler.h"
#include "drivers/lidar/packet_clock.h"

namespace rigor::gnss {

using packet_lidar::TimeSource;

class ReceiverStream {
 public:
  struct Options {
    TimeSource time = TimeSource::device;
    Duration output_delay = milliseconds(30);  ///< from the instant to the first byte of its messages
    Duration output_delay_sigma = milliseconds(10);
    Duration period;  ///< between solutions; 0: not known, then losses are not
    EpochAssembler::Options epoch;
    bool repair_rollover = false;  ///< dates that are 1024 weeks behind this machine's are put right
  };
  /// Where something lies on the bench clock, and in the order of the channel.
  struct Place {
    BenchTime t_capture;
    BenchTime arrival;  ///< of the first message of the instant
    Duration sigma;
    std::uint64_t sequence = 0, lost_before = 0;
    std::uint32_t validity = 0;
  };
  struct Handler {
    std::function<void(const Solution&, const Place&)> solution;
    std::function<void(const Sky&, const Place&)> sky;
    std::function<void(const TimePulse&)> pulse;
    std::function<void(Bytes payload)> raw;
    std::function<void(const Message&)> message;  ///< every one, before what it means
  };
  struct Counters {
    std::uint64_t clock_steps = 0, solutions_lost = 0, rollovers = 0, edges = 0;
  };

  ReceiverStream(const Options& options, Handler handler);
  ReceiverStream(const ReceiverStream&) = delete;
  ReceiverStream& operator=(const ReceiverStream&) = delete;

  /// I/O thread. Calls the handler.
  void take(Bytes bytes, BenchTime arrival);
  /// Nothing came for longer than messages of one instant lie apart.
  void idle();
  /// The end of a recording.
  void finish();
  /// The connection was lost. The sequence goes on; what was missed is counted by the receiver's own time.
  void reconnected();
  /// An edge of the time pulse was seen between these instants. It is tied to the pulse that was announced
  /// last, if that was within the last second.
  void take_edge(BenchTime before, BenchTime after);
  [[nodiscard]] packet_lidar::PacketClock& clock() { return clock_; }
  [[nodiscard]] const MessageStream& messages() const { return messages_; }
  [[nodiscard]] const EpochAssembler& epochs() const { return epochs_; }
  [[nodiscard]] const Counters& counters() const { return counters_; }
  /// The solution that came last, for those who ask between them.
  [[nodiscard]] const Solution& last() const { return last_; }

 private:
  void drain(BenchTime arrival);
  [[nodiscard]] bool in_step(DeviceTime t, BenchTime arrival);
  void place_solution(Solution s, BenchTime arrival);
  void place_sky(const Sky& sky);

  Options options_;
  Handler handler_;
  packet_lidar::PacketClock clock_;
  MessageStream messages_;
  EpochAssembler epochs_;
  Counters counters_;
  Solution last_;
  Place last_place_;
  bool any_ = false;
  DeviceTime last_time_;
  std::uint64_t sequence_ = 0, sky_sequence_ = 0;
  std::optional<TimePulse> announced_;
  BenchTime announced_at_, now_;
  BenchTime begun_;  ///< when the first byte came of what is no whole message yet
  /// The solution before, for `in_step`.
  std::optional<std::pair<DeviceTime, BenchTime>> before_;
};

}  // namespace rigor::gnss
