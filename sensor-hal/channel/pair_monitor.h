// A pair under watch in a run: feeds the watch, keeps what its windows said, and tells the loop of each.
//
//   worker        add(real, simulated) ──▶ PairWatch ──window ends──▶ kept, and a note ──ring──▶ loop: take()
//   any thread    status(), windows(), acknowledge(), learn_again()                              recorder,
//   event
//
// A note is a sample of kind event. The note of a window has its numbers as bytes (PairWindow); that of an
// alarm, or of an order, says in words what happened. In virtual time the loop takes notes only after the
// worker is through with all pairs, so that they come in the same cycle on any number of threads.
#pragma once

#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/pair_statistics.h"
#include "sensor-hal/channel/pair_watch/pair_watch.h"

namespace rigor {

// EventInfo::code of notes. `value`: of an alarm the estimated change, in the parameter's unit.
inline constexpr std::uint32_t kEventPairWindow = 0x20;  ///< for the recorder alone: carries a PairWindow
inline constexpr std::uint32_t kEventPairAlarm = 0x21;  ///< the simulated side no longer describes the device
inline constexpr std::uint32_t kEventPairWatching = 0x22;  ///< the baseline is complete
inline constexpr std::uint32_t kEventPairOrder = 0x23;     ///< acknowledged, or learning again

/// One window of a pair that is watched. Plain data.
struct PairWindow {
  BenchTime t_start, t_end;
  pair_watch::WatchState state = pair_watch::WatchState::learning;  ///< after it
  std::uint32_t parameters = 0;
  std::uint32_t learned = 0, baseline = 0;  ///< windows of the baseline
  std::uint64_t number = 0;                 ///< of the run
  std::uint64_t compared = 0, unlike = 0;   ///< pairs in it
  Difference difference;                    ///< real − simulated of all elements; of numbers: of the first
  pair_watch::Estimate estimate;
  std::array<float, pair_watch::kMaxParameters> level{};  ///< 1 is the alarm
};

class PairMonitor {
 public:
  static constexpr std::size_t kKept = 512;

  /// Setup.
  explicit PairMonitor(pair_watch::PairWatch watch);

  /// Setup: forgets everything. Before the first pair of a run that begins at t0.
  void start(BenchTime t0);
  /// Worker; pairs in the order of capture. `difference`: empty where the two could not be compared.
  void add(const Sample& real, const Sample& simulated, const std::optional<Difference>& difference);
  /// Loop thread, wait-free: the next note; empty when there is none.
  [[nodiscard]] SampleLease take() noexcept;

  // Any thread but the loop's; may wait for the worker.
  struct Status {
    pair_watch::PairWatchSnapshot watch;
    std::string text;  ///< of the last alarm; empty before the first
    BenchTime t0;
    std::uint64_t untold = 0;  ///< notes that found no place
  };
  [[nodiscard]] Status status() const;
  /// Windows so far; of long runs every second, fourth, …, so that there are at most kKept. The newest is
  /// always the last.
  [[nodiscard]] std::vector<PairWindow> windows() const;
  /// What each parameter's baseline was like, in the order of `parameters`.
  [[nodiscard]] std::vector<pair_watch::ParameterState> baseline() const;
  /// The alarm is over; wrong_state where there is none.
  [[nodiscard]] rigor::Status acknowledge();
  /// What is now is taken as normal.
  void learn_again();

  /// Never changes.
  [[nodiscard]] const std::vector<pair_watch::Parameter>& parameters() const { return fresh_.parameters(); }

 private:
  void window_ended(pair_watch::WatchState before, std::uint64_t compared, std::uint64_t unlike);
  void keep(const PairWindow& window);
  void note(std::uint32_t code, double value, BenchTime t, const std::string& text, const PairWindow* window);

  const pair_watch::PairWatch fresh_;
  mutable std::mutex mutex_;  ///< guards what follows, but for the ring's other end
  pair_watch::PairWatch watch_;
  BenchTime t0_, t_newest_;
  std::vector<PairWindow> kept_;
  PairWindow newest_;
  std::uint64_t stride_ = 1;
  std::string text_;
  std::uint64_t unreported_ = 0, sequence_ = 0;
  std::uint64_t compared_ = 0, unlike_ = 0;  ///< before the window that is open
  // Of the window that is open: sums of differences.
  double count_ = 0, mean_ = 0, m2_ = 0;
  std::unique_ptr<SamplePool> pool_;
  std::optional<SpscRing<SampleLease>> notes_;
};

}  // namespace rigor
