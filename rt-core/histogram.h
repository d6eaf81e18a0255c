// Latencies from one nanosecond to centuries in 15 KiB: each power of two is cut into 32 equal parts, so a
// value is known to within 1/64 of itself (half a part's width; below 64 ns exactly).
//
//   Histogram h;
//   h.record(Duration(1234));           // loop
//   h.percentile(0.99).ns();            // afterwards
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "rt-core/time.h"

namespace rigor {

/// One writer; readers wait until it is done or copy it. Fixed size, no allocation.
class Histogram {
 public:
  static constexpr int kPartBits = 5;                 ///< 2^5 parts in a power of two
  static constexpr double kRelativeError = 1.0 / 64;  ///< of any value that percentile() gives
  static constexpr std::size_t kBuckets = 64 + (63 - kPartBits - 1) * (1u << kPartBits);

  /// Any value; below zero counts as zero, and is counted in below_zero() too. Real-time.
  void record(Duration d) noexcept {
    const std::int64_t ns = std::max<std::int64_t>(d.ns(), 0);
    below_zero_ += d.ns() < 0;
    ++counts_[index(static_cast<std::uint64_t>(ns))];
    ++count_;
    min_ = std::min(min_, ns);
    max_ = std::max(max_, ns);
    sum_ += static_cast<double>(ns);
  }
  [[nodiscard]] std::uint64_t count() const noexcept { return count_; }
  [[nodiscard]] std::uint64_t below_zero() const noexcept { return below_zero_; }
  [[nodiscard]] Duration min() const noexcept { return Duration(count_ ? min_ : 0); }
  [[nodiscard]] Duration max() const noexcept { return Duration(max_); }
  [[nodiscard]] double mean_ns() const noexcept { return count_ ? sum_ / static_cast<double>(count_) : 0; }

  /// The value that a share `p` of all records does not exceed (nearest rank), to kRelativeError; 0 when
  /// empty.
  [[nodiscard]] Duration percentile(double p) const noexcept {
    if (count_ == 0) return Duration(0);
    const double rank = std::ceil(std::clamp(p, 0.0, 1.0) * static_cast<double>(count_));
    const auto wanted = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(rank));
    if (wanted >= count_) return max();
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < kBuckets; ++i) {
      seen += counts_[i];
      if (seen >= wanted) return Duration(std::clamp(middle(i), min_, max_));
    }
    return max();
  }
  void merge(const Histogram& o) noexcept {
    for (std::size_t i = 0; i < kBuckets; ++i) counts_[i] += o.counts_[i];
    count_ += o.count_;
    below_zero_ += o.below_zero_;
    sum_ += o.sum_;
    min_ = std::min(min_, o.min_);
    max_ = std::max(max_, o.max_);
  }
  void clear() noexcept { *this = Histogram(); }

  /// For drawing: `f(lower, upper, count)` for each bucket that is not empty; values v with lower ≤ v <
  /// upper.
  template <class F>
  void for_each(F&& f) const {
    for (std::size_t i = 0; i < kBuckets; ++i)
      if (counts_[i]) f(Duration(lower(i)), Duration(lower(i) + width(i)), counts_[i]);
  }

 private:
  static constexpr std::uint64_t kParts = 1u << kPartBits;
  static constexpr std::size_t index(std::uint64_t v) noexcept {
    if (v < 2 * kParts) return v;
    const int shift = static_cast<int>(std::bit_width(v)) - 1 - kPartBits;  // >= 1
    return static_cast<std::size_t>(shift) * kParts + (v >> shift);
  }
  static constexpr std::int64_t lower(std::size_t i) noexcept {
    if (i < 2 * kParts) return static_cast<std::int64_t>(i);
    const std::uint64_t shift = i / kParts - 1;
    return static_cast<std::int64_t>((i - shift * kParts) << shift);
  }
  static constexpr std::int64_t width(std::size_t i) noexcept {
    return i < 2 * kParts ? 1 : std::int64_t{1} << (i / kParts - 1);
  }
  static constexpr std::int64_t middle(std::size_t i) noexcept { return lower(i) + (width(i) - 1) / 2; }

  std::array<std::uint64_t, kBuckets> counts_{};
  std::uint64_t count_ = 0, below_zero_ = 0;
  double sum_ = 0;
  std::int64_t min_ = std::numeric_limits<std::int64_t>::max(), max_ = 0;
};

}  // namespace rigor
