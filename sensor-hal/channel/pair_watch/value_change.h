// What has changed between a channel of numbers (registers, decoded CAN signals, inertial units) and its
// simulated side; each number on its own. Of real y and simulated x at the same instants:
//
//   y − x = bias + scale · x − delay · dx/dt + noise
//
//   bias    in the number's unit, at x = 0 where scale is told, else at the window's mean
//   scale   relative; not of places, whose zero is nowhere
//   delay   s; positive: the real side shows what was, later than the simulated side
//   noise   logarithm of the variance that second differences leave of y − x (both sides'); of numbers that
//           are exact there is none
//
// Scale and delay are told where x moves: by more than 5 times its own noise (by second differences) and by
// more than a tenth of its mean (places: whatever that is); what the noise of x does to both (attenuation) is
// taken off by moments. A number that stands still has a bias and noise alone.
//
// At most ten numbers: four parameters each.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"

namespace rigor::pair_watch {

struct WatchedValue {
  std::string name, unit;
  double resolution = 0;  ///< steps of whole numbers: noise is never less than theirs, resolution²/12
  bool has_scale = true;  ///< false: of a place
};

class ValueChange {
 public:
  /// Setup. bad_input: none or more than ten numbers, a resolution below 0.
  [[nodiscard]] static Result<ValueChange> make(const std::vector<WatchedValue>& values);
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return parameters_; }

  // One thread at a time; no allocation.
  /// Values of one instant, in the order of `make`; `t_s` increases. What is not finite, and what stands for
  /// an instant not after the last one, is left out. False: other sizes; nothing has happened.
  bool add(double t_s, std::span<const double> real, std::span<const double> simulated) noexcept;
  void finish(Estimate& estimate) noexcept;

 private:
  struct Instant {
    double t_s = 0, x = 0, residual = 0;
  };
  struct Value {
    double resolution = 0, origin = 0;
    std::size_t first = 0;  ///< of its parameters
    bool has_scale = true, any = false;
    std::array<Instant, 3> last{};  ///< newest last
    std::uint64_t run = 0;          ///< instants in a row
    WindowFit fit{3}, still{1};
    double x_sum = 0, x_squares = 0, x_second = 0, r_second = 0, slope_noise = 0, count = 0;
  };
  explicit ValueChange(const std::vector<WatchedValue>& values);
  std::vector<Parameter> parameters_;
  std::vector<Value> values_;
};

}  // namespace rigor::pair_watch
