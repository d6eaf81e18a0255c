#include "calibration/latency/order_statistics.h"

#include <algorithm>
#include <cmath>

namespace rigor::calibration {

std::size_t samples_needed(double quantile, double confidence) {
  return static_cast<std::size_t>(std::ceil(std::log1p(-confidence) / std::log(quantile)));
}

double quantile_below_largest(std::size_t n, double confidence) {
  return std::pow(1 - confidence, 1 / static_cast<double>(n));
}

std::optional<std::size_t> upper_rank(std::size_t n, double quantile, double confidence) {
  // The rank n − j is high enough where at most j samples lie above the quantile with a probability of at
  // most 1 − confidence.
  const double count = static_cast<double>(n), p = 1 - quantile, odds = p / quantile;
  // What lies farther below the mean has no weight beside 1 − confidence.
  const double far = 12 * std::sqrt(count * p * quantile) + 12;
  double j = std::floor(std::max(0.0, count * p - far));
  double term = std::exp(std::lgamma(count + 1) - std::lgamma(j + 1) - std::lgamma(count - j + 1) +
                         j * std::log(p) + (count - j) * std::log(quantile));
  double sum = term;
  if (n == 0 || sum > 1 - confidence) return std::nullopt;
  while (j < count) {
    term *= (count - j) / (j + 1) * odds;
    if (sum + term > 1 - confidence) break;
    sum += term;
    j += 1;
  }
  if (j >= count) return std::nullopt;
  return n - static_cast<std::size_t>(j);
}

std::optional<std::size_t> lower_rank(std::size_t n, double quantile, double confidence) {
  // Upside down: the samples' negatives have their (1 − q)-quantile at −x_q.
  const auto rank = upper_rank(n, 1 - quantile, confidence);
  return rank ? std::optional(n + 1 - *rank) : std::nullopt;
}

}  // namespace rigor::calibration
