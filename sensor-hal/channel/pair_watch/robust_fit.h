// Rows of pairs into the sums of a window, with Huber's weights (c = 1.345) against what stands out.
//
//   frame    fit by the rows' own weights ─▶ scale by the median ─▶ weights ─▶ fit ─▶ again ─▶ sums
//   window   sums of all frames, each over its scale² ─▶ solve
//
// Of parameters that sum to 0 (tiles, beams) those that the frame has rows of are held by one row more.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "sensor-hal/channel/pair_watch/window_fit.h"

namespace rigor::pair_watch {

/// Parameters whose sum is 0: what they have in common is another one. The last of a fit's.
struct ZeroSum {
  std::size_t first = 0, count = 0;  ///< below 2: none
};

class RobustFit {
 public:
  using Terms = std::array<WindowFit::Term, kMaxParameters>;

  RobustFit() : RobustFit(0, {}, 0) {}
  /// Setup; allocates. `rows`: of a frame, at most.
  RobustFit(std::size_t parameters, ZeroSum zero_sum, std::size_t rows)
      : zero_sum_(zero_sum), frame_(parameters), window_(parameters) {
    left_.reserve(rows), sorted_.reserve(rows);
  }

  // One thread at a time; no allocation.
  /// The rows of one pair. A row has residual, base_weight and weight, which is set; `terms_of(row, terms)`
  /// writes its terms and returns how many: increasing, that of the zero sum last.
  template <class Row, class TermsOf>
  void add(std::span<Row> rows, const TermsOf& terms_of) noexcept {
    double scale = 0;  // of the residuals against what their weights say
    for (int pass = 0; pass < 3; ++pass) {
      if (pass > 0) scale = weigh(rows, terms_of, pass == 2);
      sum(rows, terms_of);
      if (pass < 2) frame_.solve();
    }
    window_.add(frame_, 1 / (scale * scale));
  }
  /// Of all frames since the last call, into the first places of an estimate, and `left`; starts anew.
  void finish(Estimate& e) noexcept {
    if (window_.count() > 0) {
      window_.solve();
      for (std::size_t k = 0; k < window_.parameters(); ++k)
        e.value[k] = window_.value(k), e.sigma[k] = window_.sigma(k);
    }
    e.left = left_count_ > 0 ? std::sqrt(left_squares_ / left_count_) : kNaN;
    left_squares_ = left_count_ = 0;
    window_.clear();
  }

 private:
  /// Weights by what the last fit leaves; its scale.
  template <class Row, class TermsOf>
  double weigh(std::span<Row> rows, const TermsOf& terms_of, bool last) noexcept {
    left_.clear();
    for (const Row& r : rows) {
      const std::size_t n = terms_of(r, terms_);
      double left = r.residual;
      for (std::size_t k = 0; k < n; ++k)
        if (const double v = frame_.value(terms_[k].parameter); std::isfinite(v))
          left -= terms_[k].derivative * v;
      if (last) left_squares_ += left * left, ++left_count_;
      left_.push_back(std::abs(left) * std::sqrt(r.base_weight));
    }
    sorted_.assign(left_.begin(), left_.end());
    const auto middle = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 2);
    std::nth_element(sorted_.begin(), middle, sorted_.end());
    const double scale = std::max(1e-3, 1.4826 * *middle);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const double t = left_[i] / (1.345 * scale);
      rows[i].weight = t > 1 ? rows[i].base_weight / t : rows[i].base_weight;
    }
    return scale;
  }
  template <class Row, class TermsOf>
  void sum(std::span<Row> rows, const TermsOf& terms_of) noexcept {
    frame_.clear();
    double squares = 0;
    std::array<bool, kMaxParameters> seen{};
    for (const Row& r : rows) {
      const std::size_t n = terms_of(r, terms_);
      frame_.add({terms_.data(), n}, r.residual, r.weight);
      const WindowFit::Term& last = terms_[n - 1];
      if (zero_sum_.count > 1) seen[last.parameter] = true;
      squares += r.weight * last.derivative * last.derivative;
    }
    if (zero_sum_.count < 2) return;
    std::size_t n = 0;
    for (std::size_t k = zero_sum_.first; k < zero_sum_.first + zero_sum_.count; ++k)
      if (seen[k]) terms_[n++] = {k, 1};
    frame_.add({terms_.data(), n}, 0, squares);
  }

  ZeroSum zero_sum_;
  WindowFit frame_, window_;
  Terms terms_{};
  std::vector<double> left_, sorted_;
  double left_squares_ = 0, left_count_ = 0;
};

}  // namespace rigor::pair_watch
