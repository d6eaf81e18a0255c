// How far apart the two sides of a pair are: bias and sigma of real − simulated, over samples of the same
// instant.
//
// Images: over all elements (pixels, or bytes of RGB8) of rows that are looked at, in digital numbers of the
// format. A picture with more than kMaxElements is looked at in every n-th row, n the least that fits: the
// estimate then rests on fewer pixels, but still on hundreds of thousands. Sums within a picture are
// integers, hence exact; pictures are merged in the order of their capture (Chan's update of mean and sum of
// squares), hence the result does not depend on threads. Register blocks: each value on its own, in its unit.
// Inertial units, satellite receivers, odometry: likewise, see sensor-hal/channel/pair_values.h.
// Range images: ranges of the pixels where both have a return, m. Point clouds: ranges of the points of one
// firing (the same offset, ring and return), m; where no firing is in both, they are unlike.
//
// Computed on the worker pool. The loop hands two leases over and goes on.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>

#include "rt-core/published.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/side_switch.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Mean and spread of differences; sigma is the population's.
struct Difference {
  std::uint64_t count = 0;
  double bias = 0, sigma = 0;
};

struct PairSnapshot {
  std::uint64_t compared = 0;  ///< pairs of samples
  std::uint64_t unlike =
      0;  ///< same instant, but not comparable: format, size or kind differ, or one is incomplete
  std::uint64_t skipped = 0;  ///< not compared because the worker was behind (wall time only)
  Difference all;             ///< images: every element of every pair; numbers: of value 0
  Difference last;            ///< of the newest pair alone
  std::uint32_t values = 0;   ///< registers and other numbers: how many; 0 for images
  std::array<Difference, RegisterBlock::kMax> value{};

  // By side: samples that came, and instants of the other side or of the grid that it left out.
  std::array<std::uint64_t, 2> came{}, missing{};
  [[nodiscard]] std::uint64_t came_of(PairSide s) const noexcept { return came[static_cast<std::size_t>(s)]; }
  [[nodiscard]] std::uint64_t missing_of(PairSide s) const noexcept {
    return missing[static_cast<std::size_t>(s)];
  }
};

/// The difference of ranges, real − simulated, m; empty when the samples cannot be compared. Any thread, no
/// allocation. Range images of one size, point clouds in the order of firing.
[[nodiscard]] std::optional<Difference> difference_of_ranges(const Sample& real,
                                                             const Sample& simulated) noexcept;
/// The difference of two samples, real − simulated; empty when they cannot be compared. Any thread, no
/// allocation. Images only.
[[nodiscard]] std::optional<Difference> difference_of_images(const Sample& real,
                                                             const Sample& simulated) noexcept;

class PairMonitor;

class PairStatistics {
 public:
  static constexpr std::size_t kMaxElements = std::size_t{1} << 19;

  explicit PairStatistics(WorkerPool& workers) : workers_(workers) {}
  /// Setup, not started; null: none. Gets every pair that is compared, on the worker; outlives this.
  void watch(PairMonitor* monitor) noexcept { monitor_ = monitor; }
  ~PairStatistics() { stop(); }

  /// Setup. False: the worker pool takes no more strands.
  [[nodiscard]] bool start(bool virtual_time);
  void stop();

  /// Loop thread, wait-free: compare these two. They are of one instant.
  void compare(const SampleLease& real, const SampleLease& simulated) noexcept;
  /// Loop thread: a sample of this side came after `missing` instants that it left out.
  void came(PairSide side, std::uint64_t missing) noexcept;
  /// Loop thread: instants after the last sample of `side` for which there is one of the other.
  void behind(PairSide side, std::uint64_t instants) noexcept;
  /// Virtual time: until all that was handed over is computed.
  void drain();
  /// Any thread.
  [[nodiscard]] PairSnapshot snapshot() const noexcept;

 private:
  struct Job {
    SampleLease real, simulated;
  };
  struct Sums {
    std::uint64_t count = 0;
    double mean = 0, m2 = 0;
    void merge(const Difference& d) noexcept;
    [[nodiscard]] Difference result() const noexcept;
  };
  void run();

  WorkerPool& workers_;
  PairMonitor* monitor_ = nullptr;
  bool virtual_time_ = false;
  std::optional<SpscRing<Job>> jobs_;
  std::unique_ptr<WorkerPool::Strand> strand_;

  // worker
  PairSnapshot work_;
  std::array<Sums, RegisterBlock::kMax> sums_{};
  Published<PairSnapshot> published_;
  // loop
  std::atomic<std::uint64_t> skipped_{0};
  std::array<std::atomic<std::uint64_t>, 2> came_{}, missing_{}, behind_{};
};

}  // namespace rigor
