#include "bench/sweep/statistics.h"

#include <algorithm>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>

#include "rt-core/numbers.h"

namespace rigor::sweep {
namespace {

double quantile(const std::vector<double>& sorted, double q) {
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (sorted[above] - sorted[below]) * (at - static_cast<double>(below));
}

double squares_about(const std::vector<double>& values, double middle) {
  double sum = 0;
  for (const double v : values) sum += (v - middle) * (v - middle);
  return sum;
}

double mean_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

}  // namespace

Summary summarize(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  Summary s;
  s.count = values.size();
  if (values.empty()) {
    s.mean = s.sd = s.mean95.from = s.mean95.to = s.min = s.p05 = s.p50 = s.p95 = s.max = kNaN;
    return s;
  }
  std::ranges::sort(values);
  s.mean = mean_of(values);
  s.min = values.front();
  s.max = values.back();
  s.p05 = quantile(values, 0.05);
  s.p50 = quantile(values, 0.5);
  s.p95 = quantile(values, 0.95);
  if (values.size() < 2) {
    s.sd = s.mean95.from = s.mean95.to = kNaN;
    return s;
  }
  const auto n = static_cast<double>(values.size());
  s.sd = std::sqrt(squares_about(values, s.mean) / (n - 1));
  const double half = boost::math::quantile(boost::math::students_t(n - 1), 0.975) * s.sd / std::sqrt(n);
  s.mean95 = {s.mean - half, s.mean + half};
  return s;
}

Interval95 wilson95(std::size_t hits, std::size_t count) {
  constexpr double z = 1.959963984540054;  // of the normal distribution at 0.975
  const auto n = static_cast<double>(count);
  const double p = static_cast<double>(hits) / n, z2 = z * z;
  const double middle = (p + z2 / (2 * n)) / (1 + z2 / n);
  const double half = z / (1 + z2 / n) * std::sqrt(p * (1 - p) / n + z2 / (4 * n * n));
  return {std::max(0.0, middle - half), std::min(1.0, middle + half)};
}

double explained_share(const std::vector<std::vector<double>>& groups) {
  std::vector<double> all;
  double within = 0;
  std::size_t k = 0;
  for (const auto& group : groups) {
    if (group.empty()) continue;
    ++k;
    within += squares_about(group, mean_of(group));
    all.insert(all.end(), group.begin(), group.end());
  }
  if (k < 2 || all.size() <= k) return kNaN;
  const double total = squares_about(all, mean_of(all));
  if (!(total > 0)) return kNaN;
  const auto n = static_cast<double>(all.size());
  const double share = 1 - within / (n - static_cast<double>(k)) / (total / (n - 1));
  return std::max(0.0, share);
}

}  // namespace rigor::sweep
