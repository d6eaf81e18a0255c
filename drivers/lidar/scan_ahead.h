// Scans of a simulated LiDAR, measured on a thread of their own before an emulated device sends what it saw.
//
//   scan k      begins `begin(k)` after the device's start
//   measuring   two scans ahead of the one that is being sent. Where measuring takes longer than a
//               scan, whole scans are left out, so that the others are there in time
//
//   Status prepare()                      // measures once for nothing: how long it takes
//   start(t_start)
//   sending thread   use(last_scan_needed, [&](const auto& of) { … of(k) … });    // nullptr: not measured
//   stop()
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/models/lidar/scan_grid.h"

namespace rigor::packet_lidar {

/// What one scan saw.
struct Scan {
  std::uint64_t index = 0;
  bool seen = false;  ///< false: it could not be measured
  models::ScanGrid grid;
};

/// Measures one scan that begins at `t_begin` in a world that moves by `motion`; `turn_rad`: how far beyond
/// its usual start (SampleProvider::Request). `sample` is scratch memory of the provider's size.
[[nodiscard]] Status measure_scan(SampleProvider& samples, std::uint64_t index, BenchTime t_begin,
                                  const WorldMotion& motion, double turn_rad, Sample& sample, Scan& out);

class ScanAhead {
 public:
  struct Options {
    std::function<Status(std::uint64_t index, BenchTime t_begin, const WorldMotion&, Scan&)> measure;
    std::function<Duration(std::uint64_t index)> begin;  ///< after the start
    Duration scan_time;
    Scan empty;  ///< of the device's grid
    std::shared_ptr<const MotionSource> motion;
    std::atomic<std::uint64_t>* failures = nullptr;  ///< scans that could not be measured
    const char* thread = "scan";
  };
  /// Gives scan k, nullptr where there is none.
  using Of = std::function<const Scan*(std::uint64_t)>;

  explicit ScanAhead(Options options);
  ~ScanAhead() { stop(); }

  /// Setup: the first measurement takes longest.
  [[nodiscard]] Status prepare();
  /// What one scan takes, by prepare().
  [[nodiscard]] Duration measuring_time() const { return measuring_time_; }
  void start(BenchTime t_start);
  void stop();
  /// Sending thread: scans up to `last` are being sent. `f` runs under the lock and returns quickly.
  void use(std::uint64_t last, const std::function<void(const Of&)>& f);

 private:
  static constexpr std::uint64_t kAhead = 2;  ///< scans that are measured before they are sent
  static constexpr std::size_t kKept = 16;  ///< more, so that a slow measurement may be of one further ahead
  [[nodiscard]] std::uint64_t next_scan() const;
  void run();

  Options options_;
  BenchTime t_start_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Scan> scans_;     ///< k at k % kKept
  std::uint64_t measured_ = 0;  ///< scans below this one are done or given up
  std::uint64_t sending_ = 0;
  Duration measuring_time_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace rigor::packet_lidar
