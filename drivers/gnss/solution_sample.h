// The samples of a receiver's channels.
//
//   nav_fix       the place, its covariance, status and satellites used
//   registers     everything else of a solution, too, by the names of solution_values(); NaN: not told
//   point_cloud   satellites in view: x, y, z the direction from the antenna, east, north, up, of unit
//   length;
//                 remission C/N0 in dB-Hz (0: not tracked); ring the number of the satellite as NMEA and gpsd
//                 count them over all constellations (nmea_number); return_index the constellation as UBX
//                 numbers them (0 GPS, 1 SBAS, 2 Galileo, 3 BeiDou, 5 QZSS, 6 GLONASS); flags 1: used in the
//                 solution. Satellites whose direction the receiver does not know are left out
#pragma once

#include <span>

#include "drivers/gnss/gnss_settings.h"
#include "drivers/gnss/solution.h"
#include "sensor-hal/channel/stream_source.h"
#include "sensor-hal/channel/typed_values.h"

namespace rigor::gnss {

[[nodiscard]] std::span<const ValueName> solution_values();

/// What a sample is made of besides the solution.
struct ReceiverState {
  unsigned satellites_in_view = 0;
  double pulse_quantization_ns = Solution::kNone;
};
/// No allocation.
void put_solution_values(const Solution& s, const ReceiverState& state, RegisterBlock& out) noexcept;
/// Fills info, memory and size.
void put_sky(const Sky& sky, Sample& out) noexcept;

/// A StreamSource whose samples are a receiver's: what the source over a line, recordings and virtual time
/// share.
class ReceiverSource : public StreamSource {
 protected:
  /// Where the bytes come from, as of a SensorSource (drivers/lidar).
  enum class Feed : std::uint8_t { live, recording, virtual_time };
  void describe_channel(const ChannelSettings& settings, SampleKind kind);
  /// Setup.
  void open_samples(std::size_t buffers, Feed feed);
  /// Producer thread.
  void hand_solution(const Solution& s, const ReceiverStream::Place& p) noexcept;
  void hand_sky(const Sky& s, const ReceiverStream::Place& p) noexcept;
  void note_pulse(const TimePulse& p) noexcept { state_.pulse_quantization_ns = p.quantization_ns; }
  [[nodiscard]] ReceiverStream::Handler handler();
  /// Producer thread, in virtual time: whether a sample was handed over that is released after `now`.
  [[nodiscard]] bool handed_beyond(BenchTime now) const { return any_handed_ && last_release_ > now; }

 private:
  template <class Fill>
  void hand(const ReceiverStream::Place& p, Duration period, Fill&& fill) noexcept;
  Feed feed_ = Feed::live;
  RunSequence in_run_;
  ReceiverState state_;
  BenchTime last_release_;
  bool any_handed_ = false;
};

}  // namespace rigor::gnss
