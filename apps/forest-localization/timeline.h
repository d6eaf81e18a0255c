// Sums that a sensor counts up (way, turn), kept for a while by their instants, so that any stretch between
// two instants can be asked for, in whatever order samples of different latency come.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "rt-core/fixed_ring.h"
#include "rt-core/time.h"

namespace rigor::forest {

/// The last kKept entries of N sums. Setup constructs; the rest: loop thread, no allocation.
template <std::size_t N>
class Timeline {
 public:
  static constexpr std::size_t kKept = 4096;
  using Sums = std::array<double, N>;
  struct Entry {
    BenchTime t;
    Sums sums{};
  };

  /// Later than all before; others are refused.
  bool push(BenchTime t, const Sums& sums) noexcept {
    if (!entries_.empty() && t <= newest().t) return false;
    entries_.push_newest({t, sums});
    return true;
  }
  void clear() noexcept { entries_.clear(); }
  [[nodiscard]] std::size_t size() const noexcept { return entries_.size(); }
  [[nodiscard]] const Entry& operator[](std::size_t i) const noexcept { return entries_[i]; }
  [[nodiscard]] const Entry& newest() const noexcept { return entries_.back(); }
  [[nodiscard]] const Entry& oldest() const noexcept { return entries_.front(); }
  [[nodiscard]] bool covers(BenchTime t) const noexcept {
    return !entries_.empty() && t >= oldest().t && t <= newest().t;
  }
  /// Index of the first entry after `t`; size() where there is none.
  [[nodiscard]] std::size_t after(BenchTime t) const noexcept {
    std::size_t low = 0, high = size();
    while (low < high) {
      const std::size_t middle = (low + high) / 2;
      if ((*this)[middle].t > t) {
        high = middle;
      } else {
        low = middle + 1;
      }
    }
    return low;
  }
  /// Linear between entries; the first or last entry beyond them. Precondition: size() > 0.
  [[nodiscard]] Sums at(BenchTime t) const noexcept {
    const std::size_t i = after(t);
    if (i == 0) return oldest().sums;
    if (i == size()) return newest().sums;
    const Entry& a = (*this)[i - 1];
    const Entry& b = (*this)[i];
    const double u = (t - a.t).seconds() / (b.t - a.t).seconds();
    Sums out;
    for (std::size_t k = 0; k < N; ++k) out[k] = a.sums[k] + u * (b.sums[k] - a.sums[k]);
    return out;
  }
  /// Change per second over the last two entries; 0 with fewer.
  [[nodiscard]] Sums rate() const noexcept {
    Sums out{};
    if (size() < 2) return out;
    const Entry& a = (*this)[size() - 2];
    const Entry& b = newest();
    for (std::size_t k = 0; k < N; ++k) out[k] = (b.sums[k] - a.sums[k]) / (b.t - a.t).seconds();
    return out;
  }

 private:
  FixedRing<Entry> entries_{kKept};
};

}  // namespace rigor::forest
