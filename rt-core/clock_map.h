// From a device's clock to the bench clock.
//
// A camera's counter starts anywhere and runs fast or slow by some tens of ppm. Two kinds of observation tie
// it down:
//
//   latch      the device says what its clock was at some instant between `before` and `after` (GigE Vision's
//              timestamp latch, PTP): two-sided, the narrow windows are the good ones
//   arrival    a sample with device time x was here at t: one-sided, x happened before t less the smallest
//   delay;
//              the samples that came quickest are the good ones
//
//   ClockMap map({.min_delay = microseconds(120)});
//   map.add_latch(device_ns, before, after);            // device thread, every second or so
//   Mapped m = map.map(DeviceTime(frame.timestamp));    // any thread
//   stamp.t_capture = m.t;  stamp.sigma_capture = m.sigma;
//
// The model is  t = t_ref + (x − x_ref) + offset + drift · (x − x_ref);  whole nanoseconds are subtracted as
// integers, so counters near 2^62 lose nothing. Offset and drift come with their covariance from a fit over a
// sliding window; what the fit cannot know (where within its window a latch really happens) is added to
// sigma, not averaged away. A step of the device clock, or its going back, throws the old pairs away.
#pragma once

#include <cstddef>
#include <cstdint>

#include "rt-core/fixed_ring.h"
#include "rt-core/published.h"
#include "rt-core/time.h"

namespace rigor {

struct ClockMapOptions {
  Duration window = seconds(64);              ///< how far back pairs are used
  double drift_prior = 100e-6;                ///< standard uncertainty of the drift before anything was seen
  double drift_wander = 2e-8;                 ///< how much the drift may have changed since the last pair
  Duration resolution = nanoseconds(1);       ///< of the device counter
  Duration min_delay{};                       ///< arrivals: the smallest delay from device time to arrival
  Duration min_delay_sigma{};                 ///< its standard uncertainty
  Duration step_threshold = milliseconds(1);  ///< an inconsistency beyond sigma that is taken for a step
};

/// An instant of the device on the bench clock.
struct Mapped {
  BenchTime t;
  Duration sigma;            ///< standard uncertainty of t
  std::uint32_t generation;  ///< grows with each reset: stamps of two generations do not compare
  bool known;                ///< false before the first pair: t means nothing
};

class ClockMap {
 public:
  enum class Update : std::uint8_t {
    used,       ///< the pair is in the fit
    ignored,    ///< the pair tells nothing new (a late arrival, a window without end)
    suspected,  ///< the pair contradicts the map; another one like it will reset it
    reset       ///< the device clock stepped or went back: the map starts anew from this pair
  };
  struct State {
    std::int64_t x_ref = 0, t_ref = 0;  ///< ns, device and bench
    double offset_ns = 0;               ///< of t at x_ref
    double drift = 0;                   ///< d t / d x − 1
    double var_offset = 0,
           var_drift = 0;  ///< of offset_ns and drift; x_ref is the weighted mean, so they do not correlate
    double var_systematic = 0;  ///< ns²: what more pairs do not lessen
    double drift_wander = 0;
    std::int64_t x_first = 0, x_last = 0;  ///< span of the pairs used
    std::uint32_t pairs = 0, generation = 0;
  };

  explicit ClockMap(const ClockMapOptions& options = {}) noexcept;

  /// Device thread: the device's clock was `x` at some instant in [before, after]. No allocation; some µs.
  Update add_latch(DeviceTime x, BenchTime before, BenchTime after) noexcept;
  /// Device thread: a sample stamped `x` by the device was here at `arrival`. No allocation; some µs.
  Update add_arrival(DeviceTime x, BenchTime arrival) noexcept;
  /// Device thread: forget all pairs, as after a reconnection.
  void reset() noexcept;

  /// Any thread; never waits, no allocation.
  [[nodiscard]] Mapped map(DeviceTime x) const noexcept { return map(state_.load(), x); }
  [[nodiscard]] static Mapped map(const State& s, DeviceTime x) noexcept;
  /// The device's reading at a bench instant, for commands that carry a device time. 0 before the first pair.
  [[nodiscard]] DeviceTime unmap(BenchTime t) const noexcept;
  [[nodiscard]] State state() const noexcept { return state_.load(); }

 private:
  static constexpr std::size_t kPairs = 64;
  /// A latch, or the quickest arrival of a segment of time.
  struct Pair {
    std::int64_t x = 0, t = 0;  // ns
    double sigma_ns = 0;        // of t
    double width_ns = 0;        // of the latch's window
    std::uint32_t count = 1;    // arrivals of the segment
  };
  using Ring = FixedRing<Pair, kPairs>;
  struct Line;

  void forget() noexcept;
  bool step_seen(std::int64_t shift_ns, std::int64_t limit_ns) noexcept;
  void drop_old(Ring& ring) noexcept;
  void publish_latches() noexcept;
  void publish_arrivals() noexcept;
  void publish(const Line& line, double var_systematic, Ring& ring) noexcept;

  ClockMapOptions options_;
  Ring latches_, segments_;
  // The arrival segment that is being filled; it is the last one in segments_.
  std::int64_t segment_end_ = 0;
  double segment_min_ = 0, segment_sum_ = 0;
  std::uint32_t segment_count_ = 0;
  // The newest device time, and contradictions that wait for a second witness.
  std::int64_t x_last_ = 0;
  std::int64_t suspect_shift_ns_ = 0;
  std::uint32_t suspects_ = 0;
  std::uint32_t late_in_a_row_ = 0;
  BenchTime late_since_;
  State current_;
  Published<State> state_;
};

}  // namespace rigor
