// Excess of a noise's variance over what the model says: of all elements, and by level (brightness,
// remission, amplitude) against that.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "sensor-hal/channel/pair_watch/window_fit.h"

namespace rigor::pair_watch {

class NoiseSums {
 public:
  static constexpr std::size_t kLevels = 3;

  /// Of one element's difference: its square over the variance of one side. The expectation of 2 is taken
  /// off; what is far out (an edge, a leaf) counts 100 at most.
  void add(double squares_over_variance, std::size_t level) noexcept {
    const double excess = std::min(100.0, squares_over_variance) - 2;
    for (Sums* s : {&all_, &level_[level]}) s->sum += excess, s->squares += excess * excess, ++s->count;
  }
  /// Into four places of an estimate, all and the levels; starts anew. Of less than 30 elements there is
  /// nothing to be said, nor of a level that is nearly all there is.
  void finish(Estimate& e, std::size_t first) noexcept {
    if (all_.count >= 30) {
      e.value[first] = all_.mean();
      e.sigma[first] = std::sqrt(all_.variance() / all_.count);
      for (std::size_t k = 0; k < kLevels; ++k) {
        const Sums& s = level_[k];
        if (s.count < 30 || s.count > 0.9 * all_.count) continue;
        e.value[first + 1 + k] = s.mean() - all_.mean();
        e.sigma[first + 1 + k] = std::sqrt(s.variance() * (1 / s.count - 1 / all_.count));
      }
    }
    *this = {};
  }

 private:
  struct Sums {
    double sum = 0, squares = 0, count = 0;
    [[nodiscard]] double mean() const noexcept { return sum / count; }
    [[nodiscard]] double variance() const noexcept {
      return std::max(0.0, squares / count - mean() * mean());
    }
  };
  Sums all_;
  std::array<Sums, kLevels> level_;
};

}  // namespace rigor::pair_watch
