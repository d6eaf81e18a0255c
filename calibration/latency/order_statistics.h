// Confidence bounds of a quantile that need no assumption about the distribution: the sorted samples
// themselves.
//
// Of n independent draws with the q-quantile x_q, the number above x_q is binomial, Bin(n, 1 − q). So the
// sample of rank r (from 1, the smallest) is at or above x_q with the probability P(Bin(n, q) < r), whatever
// the distribution is. Source: David & Nagaraja, Order Statistics, 3rd ed., section 7.1.
//
// All: 0 < quantile < 1, 0 < confidence < 1; any thread, no allocation.
#pragma once

#include <cstddef>
#include <optional>

namespace rigor::calibration {

/// The fewest samples whose largest is at or above the quantile with this confidence: 1 − q^n ≥ confidence.
[[nodiscard]] std::size_t samples_needed(double quantile, double confidence);
/// The largest quantile that the largest of n samples bounds with this confidence; n > 0.
[[nodiscard]] double quantile_below_largest(std::size_t n, double confidence);
/// The smallest rank whose sample is at or above the quantile with this confidence; none: too few samples.
[[nodiscard]] std::optional<std::size_t> upper_rank(std::size_t n, double quantile, double confidence);
/// The largest rank whose sample is at or below the quantile with this confidence; none: too few samples.
[[nodiscard]] std::optional<std::size_t> lower_rank(std::size_t n, double quantile, double confidence);

}  // namespace rigor::calibration
