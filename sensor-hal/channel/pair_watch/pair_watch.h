// A pair under watch: its samples in, and an alarm when the device is no longer what its simulated side
// describes.
//
//   PairWatch watch = PairWatch::of_images(camera, shape, {}, {.window_s = 10}).value();
//   watch.add(real, simulated);                  // of one instant, in the order of capture
//   if (watch.snapshot().state == WatchState::alarm) puts(text_of(watch, watch.snapshot()).c_str());
//     → focal length has changed by +0.0101 ± 0.0003, since 1210 s; next best: mount y (log ratios 916, 83)
//
// Windows are stretches of capture time from the first pair on. A window without a pair is none. What comes
// out depends on the pairs and their order alone: not on threads, nor on when they were handed over.
//
// Setup: the functions that return a Result; allocate. All others: one thread at a time, no allocation, no
// wait; a worker's, not the loop's (a picture of 5 million pixels takes some milliseconds).
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "sensor-hal/channel/pair_watch/change_watch.h"
#include "sensor-hal/channel/pair_watch/cloud_change.h"
#include "sensor-hal/channel/pair_watch/image_change.h"
#include "sensor-hal/channel/pair_watch/kind_numbers.h"
#include "sensor-hal/channel/pair_watch/range_image_change.h"
#include "sensor-hal/channel/pair_watch/value_change.h"

namespace rigor::pair_watch {

/// Plain data, to be published.
struct PairWatchSnapshot {
  WatchState state = WatchState::learning;
  std::uint64_t compared = 0, unlike = 0;           ///< pairs
  std::uint64_t windows = 0;                        ///< that ended, those of the baseline included
  std::uint32_t baseline_windows = 0, learned = 0;  ///< `learned`: of the baseline, so far
  std::uint32_t parameters = 0;
  std::uint64_t alarms = 0;  ///< raised so far
  Alarm alarm;               ///< the last one
  BenchTime t_alarm,
      t_since;       ///< end of the window in which it was raised; start of the first with the change
  Estimate last;     ///< of the newest window
  BenchTime t_last;  ///< when it began
  std::array<float, kMaxParameters> level{};  ///< of the sums; 1 is the alarm
};

/// One number of a register block that is watched.
struct WatchedRegister {
  std::uint32_t index = 0;  ///< in the block
  WatchedValue value;
};

class PairWatch {
 public:
  [[nodiscard]] static Result<PairWatch> of_images(const CameraModel& camera, const ImageInfo& shape,
                                                   const ImageChangeOptions& image,
                                                   const WatchOptions& watch);
  [[nodiscard]] static Result<PairWatch> of_clouds(const CloudChangeOptions& cloud,
                                                   const WatchOptions& watch);
  [[nodiscard]] static Result<PairWatch> of_range_images(const RangeImageInfo& shape,
                                                         const RangeImageChangeOptions& range,
                                                         const WatchOptions& watch);
  [[nodiscard]] static Result<PairWatch> of_registers(const std::vector<WatchedRegister>& registers,
                                                      const WatchOptions& watch);
  /// Of a kind that is a few numbers (kind_numbers.h): imu, nav_fix, odometry.
  [[nodiscard]] static Result<PairWatch> of_numbers(SampleKind kind, const WatchOptions& watch);

  /// Two samples of one instant; those that cannot be compared are counted.
  void add(const Sample& real, const Sample& simulated) noexcept;
  void acknowledge() noexcept { watch_.acknowledge(); }
  void learn_again() noexcept { watch_.learn_again(); }

  [[nodiscard]] PairWatchSnapshot snapshot() const noexcept;
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return watch_.parameters(); }
  [[nodiscard]] const ChangeWatch& watch() const noexcept { return watch_; }
  [[nodiscard]] Duration window() const noexcept { return window_; }
  [[nodiscard]] std::uint64_t compared() const noexcept { return compared_; }
  [[nodiscard]] std::uint64_t unlike() const noexcept { return unlike_; }

 private:
  struct Registers {
    ValueChange values;
    std::vector<std::uint32_t> index;
  };
  using Change = std::variant<ImageChange, CloudChange, RangeImageChange, Registers, KindNumbers>;
  PairWatch(Change change, ChangeWatch watch, const WatchOptions& options)
      : change_(std::move(change)),
        watch_(std::move(watch)),
        window_(seconds_from(options.window_s)),
        baseline_windows_(options.baseline_windows) {}
  template <class T>
  static Result<PairWatch> make(Result<T> change, const std::vector<Parameter>& parameters,
                                const WatchOptions& options);
  void end_window() noexcept;

  Change change_;
  ChangeWatch watch_;
  Duration window_;
  std::uint32_t baseline_windows_ = 0;
  bool any_ = false;
  BenchTime start_;       ///< of the window that is open
  BenchTime last_start_;  ///< of the newest that ended
  Estimate last_;
  std::uint64_t compared_ = 0, unlike_ = 0, alarms_ = 0;
  BenchTime t_alarm_, t_since_;
  static constexpr std::size_t kStarts = 256;
  std::array<BenchTime, kStarts> starts_{};  ///< of the newest windows, by number
};

/// One sentence about the last alarm; empty before the first. Times count from `t0`. Allocates.
[[nodiscard]] std::string text_of(const PairWatch& watch, const PairWatchSnapshot& snapshot,
                                  BenchTime t0 = {});

}  // namespace rigor::pair_watch
