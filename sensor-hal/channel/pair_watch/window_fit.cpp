#include "sensor-hal/channel/pair_watch/window_fit.h"

#include <algorithm>
#include <cmath>

namespace rigor::pair_watch {

void sweep_inverse(std::span<double> a, std::size_t n, std::span<bool> swept,
                   std::span<bool> determined) noexcept {
  // A pivot that has lost all but this share of its diagonal was explained by those before it.
  constexpr double kTolerance = 1e-9;
  std::array<double, kMaxParameters> diagonal{};
  for (std::size_t i = 0; i < n; ++i) diagonal[i] = a[i * n + i], swept[i] = false;
  for (std::size_t k = 0; k < n; ++k) {
    const double pivot = a[k * n + k];
    if (!(pivot > kTolerance * diagonal[k])) continue;
    swept[k] = true;
    for (std::size_t i = 0; i < n; ++i) {
      if (i == k) continue;
      const double b = a[i * n + k] / pivot;
      if (b == 0) continue;
      for (std::size_t j = 0; j < n; ++j)
        if (j != k) a[i * n + j] -= b * a[k * n + j];
      a[i * n + k] = -b;
    }
    for (std::size_t j = 0; j < n; ++j)
      if (j != k) a[k * n + j] /= pivot;
    a[k * n + k] = 1 / pivot;
  }
  // Column j of a parameter that was not swept holds what it takes of each one that was.
  for (std::size_t i = 0; i < n; ++i) determined[i] = swept[i];
  for (std::size_t j = 0; j < n; ++j) {
    if (swept[j] || !(diagonal[j] > 0)) continue;
    for (std::size_t i = 0; i < n; ++i)
      if (swept[i] && std::abs(a[i * n + j]) * std::sqrt(diagonal[i]) > 1e-3 * std::sqrt(diagonal[j]))
        determined[i] = false;
  }
}

WindowFit::WindowFit(std::size_t parameters)
    : n_(std::min(parameters, kMaxParameters)),
      normal_(n_ * n_),
      right_(n_),
      inverse_(n_ * n_),
      value_(n_, kNaN),
      unit_(n_) {}

void WindowFit::clear() noexcept {
  std::fill(normal_.begin(), normal_.end(), 0.0);
  std::fill(right_.begin(), right_.end(), 0.0);
  count_ = squares_ = 0;
}

void WindowFit::add(std::span<const Term> terms, double residual, double weight) noexcept {
  for (std::size_t i = 0; i < terms.size(); ++i) {
    const double wj = weight * terms[i].derivative;
    double* row = &normal_[terms[i].parameter * n_];
    for (std::size_t j = i; j < terms.size(); ++j) row[terms[j].parameter] += wj * terms[j].derivative;
    right_[terms[i].parameter] += wj * residual;
  }
  squares_ += weight * residual * residual;
  ++count_;
}

void WindowFit::add(const WindowFit& other, double factor) noexcept {
  for (std::size_t i = 0; i < normal_.size(); ++i) normal_[i] += factor * other.normal_[i];
  for (std::size_t i = 0; i < n_; ++i) right_[i] += factor * other.right_[i];
  squares_ += factor * other.squares_;
  count_ += other.count_;
}

void WindowFit::correct(std::size_t i, double squares_less, double products_more) noexcept {
  normal_[i * n_ + i] -= squares_less;
  right_[i] += products_more;
}

void WindowFit::solve() noexcept {
  // In units in which every diagonal element is 1, so that one tolerance does for all of them.
  for (std::size_t i = 0; i < n_; ++i)
    unit_[i] = normal_[i * n_ + i] > 0 ? 1 / std::sqrt(normal_[i * n_ + i]) : 0;
  for (std::size_t i = 0; i < n_; ++i)
    for (std::size_t j = i; j < n_; ++j)
      inverse_[i * n_ + j] = inverse_[j * n_ + i] = normal_[i * n_ + j] * unit_[i] * unit_[j];
  sweep_inverse(inverse_, n_, swept_, determined_);
  double explained = 0, free = count_;
  for (std::size_t i = 0; i < n_; ++i) {
    value_[i] = kNaN;
    if (!swept_[i]) continue;
    double v = 0;
    for (std::size_t j = 0; j < n_; ++j)
      if (swept_[j]) v += inverse_[i * n_ + j] * right_[j] * unit_[j];
    v *= unit_[i];
    explained += v * right_[i];
    --free;
    if (determined_[i]) value_[i] = v;
  }
  for (std::size_t i = 0; i < n_; ++i)
    for (std::size_t j = 0; j < n_; ++j) inverse_[i * n_ + j] *= unit_[i] * unit_[j];
  scale_ = free > 0 ? std::max(0.0, squares_ - explained) / free : kNaN;
}

double WindowFit::sigma(std::size_t i) const noexcept {
  return determined_[i] ? std::sqrt(scale_ * inverse_[i * n_ + i]) : kNaN;
}

}  // namespace rigor::pair_watch
