#include "calibration/lidar/rounded_values.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace rigor::calibration {
namespace {

double log_share(double from, double to) {
  // Φ(to) − Φ(from) on the side of the tail where it does not cancel.
  if (from > 0) {
    const double a = from;
    from = -to, to = -a;
  }
  const double p =
      0.5 * (std::erfc(-to * std::numbers::sqrt2 / 2) - std::erfc(-from * std::numbers::sqrt2 / 2));
  return std::log(std::max(p, 1e-300));
}

double log_likelihood(const RoundedSeries& s, double sigma) {
  double n = 0, mean = 0;
  for (const auto& [v, k] : s.counts) n += k, mean += static_cast<double>(v) * k;
  mean /= n;
  // The true value lies within its standard error of the mean, or half a step where there is hardly noise.
  const double reach = 6 * std::max(sigma, 0.15) / std::sqrt(n) + (sigma < 1 ? 0.6 : 0);
  // A bell's integral over a grid of 0.7 of its width is exact to 1e-8 (trapezoidal rule).
  const double spacing = std::clamp(0.7 * sigma / std::sqrt(n), 0.004, 0.2);
  const int nodes = 2 * static_cast<int>(std::ceil(reach / spacing)) + 1;
  const int used = std::min(nodes, 401);
  double top = -std::numeric_limits<double>::infinity();
  std::vector<double> l(static_cast<std::size_t>(used));
  for (int i = 0; i < used; ++i) {
    const double mu = mean + reach * (2.0 * i / (used - 1) - 1);
    double sum = 0;
    for (const auto& [v, k] : s.counts)
      sum += k * log_share((static_cast<double>(v) - 0.5 - mu) / sigma,
                           (static_cast<double>(v) + 0.5 - mu) / sigma);
    l[static_cast<std::size_t>(i)] = sum;
    top = std::max(top, sum);
  }
  double integral = 0;
  for (const double x : l) integral += std::exp(x - top);
  return top + std::log(integral * 2 * reach / (used - 1));
}

}  // namespace

double rounded_variance(double sigma) {
  if (!(sigma > 0)) return 0;
  double sum = 0;
  for (int k = 1; k < 2000; ++k) {
    const double term =
        std::exp(-4 * std::numbers::pi * std::numbers::pi * k * k * sigma * sigma) / (1.0 * k * k);
    sum += term;
    if (term < 1e-9) break;
  }
  return std::max(0.0, sigma * sigma + 1.0 / 12 - sum / (2 * std::numbers::pi * std::numbers::pi));
}

RoundedSigma sigma_of_rounded(const std::vector<RoundedSeries>& series) {
  bool any = false;
  double square = 0, dof = 0;
  for (const RoundedSeries& s : series) {
    any = any || s.counts.size() > 1;
    double n = 0, mean = 0, about = 0;
    for (const auto& [v, k] : s.counts) n += k, mean += static_cast<double>(v) * k;
    if (n < 2) continue;
    mean /= n;
    for (const auto& [v, k] : s.counts)
      about += k * (static_cast<double>(v) - mean) * (static_cast<double>(v) - mean);
    square += about, dof += n - 1;
  }
  if (!any || !(dof > 0)) return {};
  const auto total = [&](double log_sigma) {
    double sum = 0;
    for (const RoundedSeries& s : series)
      if (!s.counts.empty()) sum += log_likelihood(s, std::exp(log_sigma));
    return sum;
  };
  // Around the moments' answer; golden section on the logarithm.
  const double guess = std::log(std::sqrt(std::max(0.0025, square / dof - 1.0 / 12)));
  // Moments are close where noise is more than a step.
  const bool close = guess > 0;
  double a = guess - (close ? 0.15 : 1.2), b = guess + (close ? 0.15 : 0.7);
  constexpr double kGolden = 0.6180339887498949;
  double x1 = b - kGolden * (b - a), x2 = a + kGolden * (b - a), f1 = total(x1), f2 = total(x2);
  for (int n = 0; n < (close ? 12 : 22); ++n) {
    if (f1 > f2) {
      b = x2, x2 = x1, f2 = f1;
      x1 = b - kGolden * (b - a), f1 = total(x1);
    } else {
      a = x1, x1 = x2, f1 = f2;
      x2 = a + kGolden * (b - a), f2 = total(x2);
    }
  }
  const double at = 0.5 * (a + b), h = 0.5 / std::sqrt(dof) + 0.005;
  const double curvature = (2 * total(at) - total(at - h) - total(at + h)) / (h * h);
  const double sigma = std::exp(at);
  return {sigma, curvature > 0 ? sigma / std::sqrt(curvature) : std::numeric_limits<double>::infinity()};
}

}  // namespace rigor::calibration
