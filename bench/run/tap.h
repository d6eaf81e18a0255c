// Where the live view takes what it shows from the loop, without the loop noticing.
//
//   server's thread                             loop
//   want(stream)                                …
//                                               sample(stream, lease): wanted? the lease goes into a ring of
//                                               two
//   take(stream) ◀──ring── newest lease         …                      not wanted: one comparison
//
// So no slot is held but while its sample is on its way, at most two of a stream. In virtual time the loop
// copies the sample into a slot of the tap instead: which slots of a channel are free must not depend on a
// browser. Events and commands come all, through rings of copies; what does not fit is counted.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "rt-core/port.h"
#include "rt-core/published.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/fault_injector.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::live {

/// Counts of durations in bins of half an octave from 1 µs on, written by one thread and read by any.
class LiveBins {
 public:
  static constexpr std::size_t kBins = 52;  ///< the first: below 1 µs; the last: from 33.5 s on
  void record(Duration d) noexcept;
  struct Read {
    std::array<std::uint64_t, kBins> count{};
    std::uint64_t total = 0;
    double max_us = 0;
    /// Upper edge of the bin that holds this share of all, at most the maximum; 0 where there is none.
    [[nodiscard]] double percentile_us(double share) const;
  };
  [[nodiscard]] Read read() const;
  [[nodiscard]] static double lower_us(std::size_t bin);

 private:
  std::array<std::atomic<std::uint64_t>, kBins> count_{};
  std::atomic<std::int64_t> max_ns_{0};
};

struct LiveEvent {
  std::uint32_t channel = 0;  ///< beyond the last: none
  BenchTime t;
  EventInfo info;
};
struct LiveCommand {
  std::uint32_t sink = 0;
  Command command;
};

class LiveTap {
 public:
  /// `stream` = 2·channel + side; of what is no pair the side is 0 and 1 is never used.
  struct StreamSpec {
    bool used = false;
    std::size_t max_bytes = 0;
  };
  /// Setup context.
  LiveTap(std::vector<StreamSpec> streams, bool virtual_time);
  /// Setup: for PairSource::observe. Hands on to `next`, which may be null.
  [[nodiscard]] PairObserver* observer(std::size_t channel, PairObserver* next) noexcept {
    observers_[channel].next = next;
    return &observers_[channel];
  }
  /// Loop thread, before the first cycle.
  void begin(BenchTime t0) noexcept {
    t0_ns_.store(t0.ns(), std::memory_order_relaxed);
    now_ns_.store(t0.ns(), std::memory_order_relaxed);
  }

  // ---- loop thread; wait-free, no allocation ----
  void cycle(BenchTime t, Duration late, Duration ran) noexcept;
  void sample(std::size_t stream, const SampleLease& sample) noexcept;
  /// After the port was advanced; `fresh`: its sample became visible in this cycle.
  void port(std::size_t channel, const SamplePort& port, BenchTime now) noexcept;
  void event(std::uint32_t channel, const SampleLease& event) noexcept;
  /// A fault begins or ends.
  void fault(const FaultChange& change) noexcept;
  void command(std::uint32_t sink, const Command& command) noexcept;
  /// Whether `motion` is asked for.
  [[nodiscard]] bool wants_motion() const noexcept { return want_motion_.load(std::memory_order_acquire); }
  void motion(const WorldMotion& motion, BenchTime t) noexcept;
  /// The next note for the recording, as an event at this cycle's time; empty: none.
  [[nodiscard]] SampleLease next_note(BenchTime now) noexcept;

  // ---- server's thread ----
  void want(std::size_t stream) noexcept;
  /// The newest that came since; empty: none did.
  [[nodiscard]] SampleLease take(std::size_t stream) noexcept;
  [[nodiscard]] bool take(LiveEvent& event) noexcept { return events_.try_pop(event); }
  [[nodiscard]] bool take(FaultChange& change) noexcept { return faults_.try_pop(change); }
  [[nodiscard]] bool take(LiveCommand& command) noexcept { return commands_.try_pop(command); }
  /// Any thread.
  void want_motion() noexcept { want_motion_.store(true, std::memory_order_release); }
  struct MotionAt {
    BenchTime t;
    std::uint64_t count = 0;  ///< 0: none was published yet
    WorldMotion motion;
  };
  [[nodiscard]] MotionAt motion() const noexcept { return motion_.load(); }

  struct ChannelState {
    std::atomic<std::uint8_t> status{0};
    std::atomic<std::uint64_t> fresh{0}, superseded{0}, late_samples{0}, lost{0}, disconnected_cycles{0},
        overflow{0}, sequence{0};
    std::atomic<std::int64_t> t_fresh_ns{0}, t_capture_ns{0};
    LiveBins age;
  };
  [[nodiscard]] const ChannelState& channel(std::size_t i) const noexcept { return *channels_[i]; }
  [[nodiscard]] const LiveBins& wake() const noexcept { return wake_; }
  [[nodiscard]] const LiveBins& cycle_time() const noexcept { return cycle_time_; }
  [[nodiscard]] BenchTime t0() const noexcept { return BenchTime(t0_ns_.load(std::memory_order_relaxed)); }
  /// Of the newest cycle; t0 before the first.
  [[nodiscard]] BenchTime now() const noexcept { return BenchTime(now_ns_.load(std::memory_order_relaxed)); }
  /// Events and commands that found no place.
  [[nodiscard]] std::uint64_t lost() const noexcept { return lost_.load(std::memory_order_relaxed); }

  // ---- the thread that answers services ----
  /// Into the recording as an event. False: too many at once.
  [[nodiscard]] bool note(std::uint32_t code, double value, std::string_view text) noexcept;

 private:
  struct Stream {
    bool used = false;
    std::atomic<bool> wanted{false};
    SpscRing<SampleLease> ring{2};
    std::unique_ptr<SamplePool> copies;  ///< virtual time
  };
  class Observer final : public PairObserver {
   public:
    void on_window(const SampleLease& window) noexcept override {
      if (next) next->on_window(window);
    }
    void on_side_sample(PairSide side, const SampleLease& sample) noexcept override {
      tap->sample(2 * channel + static_cast<std::size_t>(side), sample);
      if (next) next->on_side_sample(side, sample);
    }
    LiveTap* tap = nullptr;
    std::size_t channel = 0;
    PairObserver* next = nullptr;
  };

  std::vector<std::unique_ptr<Stream>> streams_;
  std::vector<std::unique_ptr<ChannelState>> channels_;
  std::vector<Observer> observers_;
  SpscRing<LiveEvent> events_{256};
  SpscRing<FaultChange> faults_{256};
  SpscRing<LiveCommand> commands_{1024};
  SpscRing<EventInfo> notes_{32};
  std::unique_ptr<SamplePool> note_pool_;
  std::uint64_t note_sequence_ = 0;
  std::atomic<std::uint64_t> lost_{0};
  std::atomic<bool> want_motion_{false};
  Published<MotionAt> motion_;
  std::uint64_t motion_count_ = 0;
  LiveBins wake_, cycle_time_;
  std::atomic<std::int64_t> now_ns_{0}, t0_ns_{0};
};

}  // namespace rigor::live
