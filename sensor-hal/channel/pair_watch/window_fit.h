// Least squares of a window: residuals of a pair (real − simulated) on columns of named parameters.
//
//   r_i = Σ_k J_ik δ_k + noise,   δ̂ = (Jᵀ W J)⁻¹ Jᵀ W r
//
// A window may not determine every parameter (a white wall says nothing of the focal length). What it does
// not determine, or only together with another, is NaN and takes nothing from the rest. Sums are of doubles
// in the order of the calls, so a result is that of its input alone.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "rt-core/numbers.h"

namespace rigor::pair_watch {

inline constexpr std::size_t kMaxParameters = 40;

/// Of the real device against its simulated side: the change that is watched for.
struct Parameter {
  std::string name, unit;
  double least = 0;  ///< the smallest change that is worth an alarm, in `unit`; 0: whatever shows
  /// One of several whose sum is 0 (tiles, beams): the place of the parameter that carries what they have in
  /// common. A change of one of them alone moves the sum, hence that and all others, too.
  int common = -1;
};

/// What a window says of each parameter; NaN: nothing. Sigmas are those that the residuals of this window
/// show and hold for independent elements; what changes from window to window is learned elsewhere.
struct Estimate {
  std::array<double, kMaxParameters> value{}, sigma{};
  // What is left of the elements' residuals once the window's parameters are taken off; NaN: not told.
  double left = kNaN;         ///< root mean square, DN (cells of pictures) or m; not of numbers
  double shift_px = kNaN;     ///< of pictures: by how much focal length and mount move what is seen, rms
  double features_px = kNaN;  ///< of pictures: how far features are apart after that, rms (feature_shift.h)
};

/// Inverse of a symmetric n×n matrix (row by row), in place, by sweeping its diagonal (Goodnight, The
/// American Statistician 33, 1979). What those before it explain is not swept; between swept ones there is
/// the inverse of their part of the matrix. `determined`: swept, and apart from all that is not. Any thread;
/// no allocation.
void sweep_inverse(std::span<double> matrix, std::size_t n, std::span<bool> swept,
                   std::span<bool> determined) noexcept;

class WindowFit {
 public:
  /// Setup; allocates. At most kMaxParameters.
  explicit WindowFit(std::size_t parameters);

  struct Term {
    std::size_t parameter = 0;
    double derivative = 0;
  };
  // What follows: one thread at a time; no allocation.
  void clear() noexcept;
  /// One residual; terms that are not named are 0. Parameters of the terms increase.
  void add(std::span<const Term> terms, double residual, double weight) noexcept;
  /// The sums of another fit, times a factor on its weights.
  void add(const WindowFit& other, double factor) noexcept;
  /// Columns that are measured themselves: takes what their noise adds off the sums of squares of column i,
  /// and adds to its sum of products with the residual.
  void correct(std::size_t i, double squares_less, double products_more) noexcept;
  /// Estimates into the first places of `value` and `sigma`. Residuals that were added: `count`.
  void solve() noexcept;

  [[nodiscard]] double value(std::size_t i) const noexcept { return value_[i]; }
  [[nodiscard]] double covariance(std::size_t i, std::size_t j) const noexcept {
    return scale_ * inverse_[i * n_ + j];
  }
  [[nodiscard]] double sigma(std::size_t i) const noexcept;
  /// Of a residual of weight 1, as the fit leaves them.
  [[nodiscard]] double variance() const noexcept { return scale_; }
  [[nodiscard]] double count() const noexcept { return count_; }
  [[nodiscard]] std::size_t parameters() const noexcept { return n_; }

 private:
  std::size_t n_;
  double count_ = 0, squares_ = 0, scale_ = kNaN;
  std::vector<double> normal_, right_, inverse_, value_, unit_;
  std::array<bool, kMaxParameters> swept_{}, determined_{};
};

}  // namespace rigor::pair_watch
