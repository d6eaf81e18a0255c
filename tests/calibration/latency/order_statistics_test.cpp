#include "calibration/latency/order_statistics.h"

#include <gtest/gtest.h>

#include <cmath>

namespace rigor::calibration {
namespace {

/// P(Bin(n, q) < r), term by term.
double below(std::size_t n, double q, std::size_t r) {
  double sum = 0;
  for (std::size_t i = 0; i < r; ++i) {
    double ways = 1;
    for (std::size_t j = 0; j < i; ++j) ways *= static_cast<double>(n - j) / static_cast<double>(j + 1);
    sum += ways * std::pow(q, static_cast<double>(i)) * std::pow(1 - q, static_cast<double>(n - i));
  }
  return sum;
}

TEST(OrderStatistics, RanksAreTheOutermostThatTheBinomialAllows) {
  for (const std::size_t n : {1u, 2u, 5u, 19u, 60u, 150u})
    for (const double q : {0.03, 0.3, 0.5, 0.9, 0.99})
      for (const double confidence : {0.6, 0.95, 0.999}) {
        SCOPED_TRACE(testing::Message() << n << " " << q << " " << confidence);
        const auto upper = upper_rank(n, q, confidence);
        if (upper) {
          ASSERT_TRUE(*upper >= 1 && *upper <= n);
          EXPECT_GE(below(n, q, *upper), confidence);
          EXPECT_LT(below(n, q, *upper - 1), confidence);
        } else {
          EXPECT_LT(below(n, q, n), confidence);
        }
        // P(X_(r) ≤ x_q) = P(Bin(n, q) ≥ r)
        const auto lower = lower_rank(n, q, confidence);
        if (lower) {
          ASSERT_TRUE(*lower >= 1 && *lower <= n);
          EXPECT_GE(1 - below(n, q, *lower), confidence - 1e-12);
          EXPECT_TRUE(*lower == n || 1 - below(n, q, *lower + 1) < confidence);
        } else {
          EXPECT_LT(1 - below(n, q, 1), confidence);
        }
      }
}

TEST(OrderStatistics, ManySamplesAreCountedWithoutUnderflow) {
  // Bin(10^6, 0.001): mean 1000, standard deviation 31.6; the normal's 1.645 of it, to a fraction of a rank.
  const auto rank = upper_rank(1'000'000, 0.999, 0.95);
  ASSERT_TRUE(rank);
  EXPECT_NEAR(static_cast<double>(*rank), 999'000 + 1.645 * 31.6, 2);
  const auto median = upper_rank(1'000'000, 0.5, 0.95);
  ASSERT_TRUE(median);
  EXPECT_NEAR(static_cast<double>(*median), 500'000 + 1.645 * 500, 2);
}

TEST(OrderStatistics, SamplesNeededAreThoseWhoseLargestIsABound) {
  EXPECT_EQ(samples_needed(0.95, 0.95), 59u);  // Wilks, Ann. Math. Statist. 12 (1941) 91
  EXPECT_EQ(samples_needed(0.99, 0.95), 299u);
  EXPECT_EQ(samples_needed(0.999, 0.95), 2995u);
  for (const double q : {0.9, 0.99, 0.999})
    for (const double confidence : {0.9, 0.95, 0.99}) {
      const std::size_t n = samples_needed(q, confidence);
      EXPECT_EQ(upper_rank(n, q, confidence), n);
      EXPECT_FALSE(upper_rank(n - 1, q, confidence));
      EXPECT_GE(quantile_below_largest(n, confidence), q);
      EXPECT_LT(quantile_below_largest(n - 1, confidence), q);
    }
}

}  // namespace
}  // namespace rigor::calibration
