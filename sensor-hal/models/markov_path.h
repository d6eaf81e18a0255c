// Slow errors of a sensor, three axes at once: a Gauss–Markov process of first order, or a random walk, at
// the captures 0, 1, 2 … of a channel. Every value is a pure function of key and index, whatever was asked
// before: no state to carry, no checkpoints to keep.
//
// That works because such a process between two known ends depends on nothing outside of them. The ends are
// 0 and 2^40; the value in the middle is drawn given both, then that in the middle of a half, and so on down
// to the index: Lévy's construction of Brownian motion, and the same for the Ornstein–Uhlenbeck bridge. With
// h the half length of the interval, in captures:
//
//   random walk, variance k:           middle = (a + b)/2 + z·√(h/2)
//   stationary, correlation e^(−k/T):  middle = (a + b)/(2·cosh(h/T)) + z·√(tanh(h/T))
//
// (for the second: the conditional normal of x(h) given x(0), x(2h) with r = e^(−h/T) has the weights
// r/(1 + r²) and the variance (1 − r²)/(1 + r²)). An index costs up to 40 draws; the way to the last one is
// kept, so that the next one costs two in the mean.
#pragma once

#include <array>
#include <cstdint>

#include "sensor-hal/models/philox.h"

namespace rigor::models {

/// One thread at a time; copies are free. No allocation.
class MarkovPath {
 public:
  static constexpr unsigned kLevels = 40;  ///< after 2^40 captures it comes again from the beginning

  /// Zero for ever.
  MarkovPath() = default;
  /// Unit variance; correlated as e^(−|i − k|/correlation_captures), > 0.
  [[nodiscard]] static MarkovPath stationary(PhiloxKey key, NoiseEffect effect, std::uint32_t stream,
                                             double correlation_captures);
  /// Zero at index 0; the variance grows by 1 with each capture.
  [[nodiscard]] static MarkovPath walk(PhiloxKey key, NoiseEffect effect, std::uint32_t stream);

  [[nodiscard]] std::array<double, 3> at(std::uint64_t index) noexcept;

 private:
  using Value = std::array<double, 3>;
  struct Interval {
    std::uint64_t begin = 0;  ///< of 2^level captures
    Value low{}, high{};
  };
  void set_ends(double high_of_low, double high_sigma, bool low_is_drawn);

  bool active_ = false;
  PhiloxKey key_;
  NoiseEffect effect_{};
  std::uint32_t stream_ = 0;
  std::array<double, kLevels> weight_{}, sigma_{};  ///< of a middle whose half length is 2^level
  std::array<Interval, kLevels + 1> way_{};
  unsigned known_ = kLevels;  ///< intervals of this level and above are those of the last index
};

/// Three standard normal draws. Any thread.
[[nodiscard]] std::array<double, 3> normal_draws(PhiloxKey key, NoiseEffect effect, std::uint64_t index,
                                                 std::uint32_t element) noexcept;

}  // namespace rigor::models
