// Which trees were cut, and when: written by who moves the platform, read by every simulator of the world
// that it works in, without a lock.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "rt-core/time.h"

namespace rigor {

/// A stem that can be cut.
struct Stem {
  std::uint64_t node = 0;            ///< of the world
  double x_m = 0, y_m = 0, z_m = 0;  ///< foot
};

/// A tree that a platform cut.
struct Felling {
  BenchTime t;             ///< from here on it no longer stands
  std::uint64_t node = 0;  ///< of the world
  double yaw_rad = 0;      ///< where its top points as it lies
};

/// One writer at a time; readers on any thread. No allocation once made.
class FellingLog {
 public:
  explicit FellingLog(std::vector<Stem> stems) : stems_(std::move(stems)), fellings_(stems_.size()) {}
  /// Setup: all stand again.
  void clear() noexcept { count_.store(0, std::memory_order_release); }

  /// Where a saw is, and what it can cut.
  struct Saw {
    double x_m = 0, y_m = 0;
    double lowest_foot_m = 0, highest_foot_m = 0;  ///< z of the stems' feet between which it cuts
    double reach_m = 0;                            ///< below this, from the stem's axis
  };
  /// Writer: cuts the nearest stem that stands within reach; of two equally near the first of the list.
  /// False: there is none.
  bool cut(const Saw& saw, double yaw_rad, BenchTime t) noexcept;
  /// In the order in which they were cut; what is in there does not change.
  [[nodiscard]] std::span<const Felling> fellings() const noexcept {
    return std::span(fellings_).first(count_.load(std::memory_order_acquire));
  }

 private:
  std::vector<Stem> stems_;
  std::vector<Felling> fellings_;
  std::atomic<std::size_t> count_{0};  ///< release: entries before it are whole
};

}  // namespace rigor
